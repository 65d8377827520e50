"""Every ```python block of README, guide and reference is executed, page by page, in a folder as `make run` leaves it.
Fields of JSON are those that are written, and pictures show the sections that reports have.

Pages say data/sample; here a session of nine short runs lies there. What they calibrate and diagnose is done once for
all of them, with a narrow search; README's block also runs on the bundled sample (slow).
"""

import functools
import inspect
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

import calibration
from calibration.cross_validation.cross_validation import cross_validate
from calibration.diagnosis.pipeline import diagnose, prepare
from calibration.diagnosis.report.demonstration import NOTHING_SHOWN
from calibration.diagnosis.report.document import SCHEMA
from calibration.diagnosis.report.page import write_diagnosis
from calibration.diagnosis.search.structure import Effort
from calibration.log_check.check import check_log
from calibration.twin_calibration.calibration import calibrate
from calibration.twin_calibration.report import write_calibration
from docs.make import pictures
from qcar_twin import DataSet
from tests import ROOT
from tests.scripts import tiny_session

NARROW = Effort(singles=1, pairs=0, triples=0, iterations=1)
TRIED = ("steering_offset", "steering_delay")  # mechanisms of the narrow search
BLOCK = re.compile(r"^```python\n(.*?)^```", re.M | re.S)
ELSEWHERE = {  # pages whose blocks are files of a project; who tries them
  "extending.md": "extending/example.py",
  "extending_channel.md": "extending/test_channel.py",
  "onboard.md": "qcar_twin/onboard/test_guide.py",
  "exports.md": "calibration/exports/test_exports.py",
}
BY_THE_DATA = {"Warnings"}  # sections that only some data sets' reports have
FOLDERS = [ROOT / "docs" / name for name in ("guide", "reference")]
PAGES = {
  page.name: blocks
  for page in (ROOT / "README.md", *(p for folder in FOLDERS for p in sorted(folder.glob("*.md"))))
  if (blocks := BLOCK.findall(page.read_text(encoding="utf-8")))
}


def run(blocks: list[str], page: str) -> None:
  """Execute a page's blocks one after the other, as somebody who reads on would."""
  names = {"__name__": page}
  for number, block in enumerate(blocks, 1):
    exec(compile(block, f"{page}, block {number}", "exec"), names)


@functools.cache
def worked(folder: Path):
  """A calibration and a diagnosis of the small session, and the files that `make run` would write of them."""
  data = tiny_session.write(folder / "data" / "sample", {"steering_offset": {"steering_offset": 0.04}})
  begun = prepare(data, TRIED)
  fit = calibrate(data, "recordings", quick=True, recalibrated=lambda: begun.recalibrated)
  write_calibration(fit, folder / "out" / "sample" / "calibration")
  outcome = diagnose(data, TRIED, effort=NARROW, prepared=begun)
  write_diagnosis(outcome, folder / "out" / "sample" / "diagnosis", NOTHING_SHOWN)
  shutil.copytree(folder / "data" / "sample", folder / "my_session")
  return fit, outcome


def at_hand(signature: inspect.Signature, result, *arguments, **options):
  """A result that was computed before, for a call that the function itself would take."""
  assert isinstance(signature.bind(*arguments, **options).arguments["dataset"], DataSet)
  return result


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
  """Where the blocks run: a checkout, as far as they look at it."""
  made = tmp_path_factory.mktemp("reader")
  (made / "assets").symlink_to(ROOT / "assets")
  return made


def test_readme_and_guide_have_examples_in_python():
  assert {"README.md", "twin.md", "environment.md", "estimation.md", "report.md", "recordings.md"} <= set(PAGES)
  for page, tried in ELSEWHERE.items():
    assert page in (ROOT / "tests" / tried).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", sorted(set(PAGES) - set(ELSEWHERE)))
def test_the_blocks_of_a_page_run(page, folder, monkeypatch):
  shared = dict(zip(("calibrate", "diagnose"), worked(folder), strict=True))
  for name, real in (("calibrate", calibrate), ("diagnose", diagnose)):
    monkeypatch.setattr(calibration, name, functools.partial(at_hand, inspect.signature(real), shared[name]), False)
  monkeypatch.chdir(folder)
  run(PAGES[page], page)


def fields(schema, name: str = "") -> Iterator[str]:
  """Dotted names of a schema's or a document's fields, two levels deep; what has any keys is one field."""
  inner = schema[0] if isinstance(schema, list) and schema else schema
  listed = name + ("[]" if isinstance(schema, list) and name and isinstance(inner, dict) else "")
  if isinstance(inner, dict) and "*" not in inner and listed.count(".") < 1:
    for key, part in inner.items():
      yield from fields(part, f"{listed}.{key}" if listed else key)
  else:
    yield listed


def test_fields_of_the_json_files_are_on_their_page(folder):
  text = (ROOT / "docs" / "reference" / "json.md").read_text(encoding="utf-8")
  parts = {part.split("\n", 1)[0]: part for part in text.split("\n## ")[1:]}
  fit, _ = worked(folder)
  data = DataSet.load(folder / "data" / "sample")
  validation = cross_validate(data, fit.twin, fit.theta, None, windows=(0.5,))
  written = {
    "diagnosis.json": set(fields(SCHEMA)),
    "calibration.json": set(fit.document()),
    "cross_validation.json": set(validation.document()),
    "check.json": set(check_log(data).document()),
  }
  for file, names in written.items():
    absent = sorted(name for name in names if f"`{name}`" not in parts[file])
    assert not absent, f"{file}: {', '.join(absent)}"


def test_the_pictures_show_the_sections_that_reports_have(folder):
  noted = json.loads((pictures.FOLDER / pictures.NOTED).read_text(encoding="utf-8"))
  taken = {picture.stem for picture in pictures.FOLDER.glob("report_*.png")}
  assert set(noted["pictures"]) == {shot.name for shot in pictures.SHOTS} == taken
  worked(folder)
  for report in ("calibration", "diagnosis"):
    now = pictures.titles(folder / "out" / "sample" / report / "report.html")
    changed = set(now) ^ set(noted["reports"][report])
    assert changed <= BY_THE_DATA, f"{report}: {', '.join(sorted(changed))}; run make docs"


@pytest.mark.slow
def test_readme_runs_on_the_bundled_sample(tmp_path, monkeypatch, capsys):
  (tmp_path / "data").symlink_to(ROOT / "data")
  monkeypatch.chdir(tmp_path)
  narrow = functools.partial(diagnose, candidates=("battery_sag", "motor_heating"), effort=NARROW)
  monkeypatch.setattr(calibration, "diagnose", narrow, False)
  run(PAGES["README.md"][:1], "README.md")
  assert "battery_sag" in capsys.readouterr().out
  assert (tmp_path / "repaired.toml").is_file()


@pytest.mark.slow
def test_the_bundled_samples_twin_drives_as_its_page_prints(tmp_path, monkeypatch, capsys):
  (tmp_path / "data").symlink_to(ROOT / "data")
  monkeypatch.chdir(tmp_path)
  outcome = diagnose(DataSet.load("data/sample"))
  write_diagnosis(outcome, tmp_path / "out" / "sample" / "diagnosis", NOTHING_SHOWN)
  capsys.readouterr()
  run(PAGES["twin.md"], "twin.md")
  page = (ROOT / "docs" / "guide" / "twin.md").read_text(encoding="utf-8")
  said = "".join(re.findall(r"^```text\n(.*?)^```", page, re.M | re.S))
  number = re.compile(r"\d+\.?\d*")
  now = capsys.readouterr().out
  assert number.sub("", now).split() == number.sub("", said).split()
  assert list(map(float, number.findall(now))) == pytest.approx(list(map(float, number.findall(said))), rel=0.03)
