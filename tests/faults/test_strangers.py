"""Data sets, twins, policies and archives of strangers execute nothing, read and write nothing outside their folder."""

import json
import os
import shutil

import mujoco
import numpy as np
import pytest

from agents.learning.policy_file import load_policy
from calibration.concealed.campaign.archive import unpack
from qcar_twin.pages.page import Section, write_page
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.twin.file import load_twin
from qcar_twin.twin.twin import Twin
from qcar_twin.untrusted import UnreadableFile, inside
from qcar_twin.vehicle.mjcf import car_spec
from qcar_twin.vehicle.vehicle import QCAR, Vehicle
from tests import ROOT
from tests.faults.bombs import BOMBS
from tests.faults.samples import KINDS
from tests.qcar_twin.recordings.drives import drive, write_csv, write_manifest


@pytest.fixture
def secret(tmp_path):
  """A good recording outside the data set's folder, and the folder."""
  (tmp_path / "secret").mkdir()
  (tmp_path / "data").mkdir()
  write_csv(tmp_path / "secret" / "run.csv", *drive(1.0))
  return tmp_path / "secret" / "run.csv", tmp_path / "data"


@pytest.mark.parametrize("way", ["../secret/run.csv", "absolute", "link", "folder", "sub/../../secret/run.csv"])
def test_a_data_set_reads_nothing_outside_its_folder(secret, way):
  file, folder = secret
  name = {"absolute": str(file), "link": "run.csv", "folder": "sub/run.csv"}.get(way, way)
  if way == "link":
    (folder / "run.csv").symlink_to(file)
  if way == "folder":
    (folder / "sub").symlink_to(file.parent)
  write_manifest(folder, (name,))
  with pytest.raises(RecordingError, match="lies outside .* copy that file there"):
    DataSet.load(folder)


def test_links_and_folders_inside_the_folder_are_followed(secret):
  file, folder = secret
  (folder / "sub").mkdir()
  shutil.copy(file, folder / "sub" / "run.csv")
  (folder / "link.csv").symlink_to("sub/run.csv")
  assert len(DataSet.load(write_manifest(folder, ("sub/../sub/run.csv",))).recordings) == 1
  assert len(DataSet.load(write_manifest(folder, ("link.csv",))).recordings) == 1


def test_a_data_set_whose_folder_is_a_link_is_read(secret):
  file, folder = secret
  shutil.copy(file, folder / "run.csv")
  write_manifest(folder, ("run.csv",))
  (folder.parent / "shortcut").symlink_to(folder)
  assert DataSet.load(folder.parent / "shortcut").recordings


def test_a_bag_whose_part_is_a_link_to_elsewhere_is_refused(tmp_path):
  KINDS["ros2 sqlite"].make(tmp_path)
  part = next((tmp_path / "drive").glob("*.db3"))
  (tmp_path.parent / "elsewhere.db3").write_bytes(part.read_bytes())
  part.unlink()
  part.symlink_to(tmp_path.parent / "elsewhere.db3")
  with pytest.raises(RecordingError, match="lies outside"):
    DataSet.load(tmp_path)


@pytest.mark.parametrize("name", ["../../run", "/etc/run", "a/b", ".hidden", "a\\\\b", "line\\nbreak"])
def test_a_recording_is_never_named_out_of_the_folder_of_results(secret, name):
  file, folder = secret
  shutil.copy(file, folder / "run.csv")
  write_manifest(folder, ("run.csv",), extra=f'name = "{name}"')
  with pytest.raises(RecordingError, match="cannot be a file name"):
    DataSet.load(folder)


def test_a_pipe_is_no_recording(secret):
  os.mkfifo(secret[1] / "run.csv")
  with pytest.raises(RecordingError, match="neither a file nor a folder"):
    DataSet.load(write_manifest(secret[1], ("run.csv",)))


@pytest.mark.parametrize("name", ["\0", "a" * 5000, "loop"])
def test_names_that_no_file_can_have_are_refused(tmp_path, name):
  (tmp_path / "loop").symlink_to("loop")
  with pytest.raises(UnreadableFile, match="correct"):
    inside(tmp_path, name)


def test_an_unknown_mechanism_in_a_twin_file_is_named_with_the_nearest(tmp_path):
  (file,) = KINDS["twin.toml"].make(tmp_path)
  text = (tmp_path / file).read_text().replace("mechanisms.steering_offset", "mechanisms.steering_ofset")
  (tmp_path / file).write_text(text)
  with pytest.raises(UnreadableFile, match="twin.toml: no mechanism 'steering_ofset'; did you mean steering_offset"):
    load_twin(tmp_path / file)


def test_a_twin_file_runs_no_python_that_it_names(tmp_path, monkeypatch):
  monkeypatch.chdir(tmp_path)
  (tmp_path / "own.py").write_text("open('cracked', 'w')")
  (file,) = KINDS["twin.toml"].make(tmp_path)
  for name in ('"own.py"', '"./own"', "\"__import__('own')\""):
    text = (tmp_path / file).read_text().replace("mechanisms.steering_offset", f"mechanisms.{name}")
    (tmp_path / "other.toml").write_text(text)
    with pytest.raises(UnreadableFile, match="no mechanism"):
      load_twin(tmp_path / "other.toml")
  assert not (tmp_path / "cracked").exists()


def test_no_text_of_a_vehicle_becomes_part_of_the_model(tmp_path):
  """The model is built from numbers; the only MJCF that is parsed is the package's own."""
  name = '"/><include file="/etc/passwd"/><asset><mesh file="/etc/passwd"/></asset><a b="'
  model = car_spec(Vehicle(name=name)).compile()
  assert model.nmesh == 0 and model.nbody == Twin(QCAR, threads=1).model.nbody
  with pytest.raises(ValueError, match="law"):
    car_spec(Vehicle(tyre_law="../../etc/passwd"))
  parsed = [
    p.name for p in (ROOT / "qcar_twin").rglob("*.py") if "MjSpec.from" in p.read_text() or "from_xml" in p.read_text()
  ]
  assert parsed == ["mjcf.py"] and mujoco.MjSpec.from_file(str(ROOT / "assets" / "qcar.xml"))


def test_a_pickle_in_a_policys_place_is_not_run(tmp_path, monkeypatch):
  monkeypatch.chdir(tmp_path)
  KINDS["policy.safetensors"].make(tmp_path)
  BOMBS["a pickle called safetensors"][1](tmp_path)
  with pytest.raises(UnreadableFile, match="not a readable safetensors file"):
    load_policy(tmp_path)
  assert not (tmp_path / "cracked").exists()


def test_a_policy_of_another_shape_or_without_a_finite_number_is_refused(tmp_path):
  KINDS["policy.json"].make(tmp_path)
  good = json.loads((tmp_path / "policy.json").read_text())
  assert np.isfinite(load_policy(tmp_path).rate(np.zeros((1, 4)))).all()
  for change, said in (
    ({"layers": 2}, "with one output"), ({"observation_scale": [1.0]}, "does not fit"), ({"lock": "1"}, "lock"),
    ({"observation_scale": [1e308, 1.0, 1.0, 1.0]}, "too large"), ({"sight": {"previews": ["x"]}}, "sight"),
  ):  # fmt: skip
    (tmp_path / "policy.json").write_text(json.dumps(good | change))
    with pytest.raises(UnreadableFile, match=said):
      load_policy(tmp_path)


def test_an_archive_writes_nothing_outside_its_folder(tmp_path):
  BOMBS["archive of a name that leads out"][1](tmp_path)
  with pytest.raises(UnreadableFile, match="answers.jsonl.xz: .*lies outside"):
    unpack(tmp_path / "answers.jsonl.xz", tmp_path / "deep" / "unpacked")
  assert not list(tmp_path.rglob("*cracked*"))


def test_a_name_in_a_report_is_text_and_no_script(tmp_path):
  page = write_page(
    tmp_path / "a.html", "<script>alert(1)</script>", "<b>yes</b>", [Section("<i>", "<img src=x>")], "&"
  )
  assert "<script>alert(1)" not in page.read_text() and "<img src=x>" not in page.read_text()
