"""A mechanism is one file: the example of the page is found, simulated, offered to the diagnosis, held to contract."""

import os
import subprocess
import sys

import pytest

from tests import ROOT
from tests.extending.example import Copy, files_of

((PATH, SOURCE),) = files_of("A mechanism").items()

_SEEN = """
import sys, pathlib, numpy as np
import qcar_twin
from qcar_twin.plant import START, Segments
from qcar_twin.twin.mechanisms import add_file, catalogue, select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR
from calibration.diagnosis.considered import always_free, considered
from calibration.fitting.dataset_recalibration import starting_priors
from calibration.diagnosis.scan import trial_starts
from qcar_twin.plant import Driving

for file in sys.argv[1:]:
  assert "cable_pull" not in catalogue()
  assert add_file(file) == add_file(file) == ("cable_pull",)
assert list(catalogue()).count("cable_pull") == 1
start = np.zeros((1, len(START)))
start[0, START.index("velocity_x")] = 1.0
drive = Segments(np.tile([1.0, 0.1], (1, 60, 1)), start, np.full(1, 60), 0.01, ("a",), np.zeros(1))
twin, bare = Twin(QCAR, select(["cable_pull"]), threads=1), Twin(QCAR, threads=1)
null, pulled = twin.parameters.nominal, twin.parameters.vector({"cable_pull": 2.0})
runs, absent = twin.rollout(np.stack([null, pulled]), drive), bare.rollout(bare.parameters.nominal, drive)
assert np.array_equal(runs.signals[0], absent.signals[0])
x = runs.channel("pose_x")[:, 0, -1]
assert 0.01 < x[0] - x[1] < 0.3, x
known = considered(None, None)
(mine,) = (m for m in known if m.name == "cable_pull")
everything = Twin(QCAR, known, threads=1)
assert not always_free(mine, starting_priors([], everything, None))
assert trial_starts(mine, (0.8,), Driving(0.0, 60.0, np.zeros((1, 2)))) == [{"cable_pull": 0.4}]
assert [m.name for m in considered(["cable_pull"], None)][0] == "cable_pull"
print("seen")
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
  return Copy(tmp_path_factory.mktemp("project"))


def test_a_file_outside_the_package_is_a_mechanism_too(copy, tmp_path):
  """Before the copy gets the same file: afterwards its name would be taken."""
  if (copy.folder / PATH).exists():
    pytest.skip("the copy has it already")
  file = tmp_path / "cable_pull.py"
  file.write_text(SOURCE, encoding="utf-8")
  assert copy.python("-c", _SEEN, str(file)).strip() == "seen"
  assert copy.touched() == set()


def test_a_twin_file_names_such_a_mechanism_and_brings_no_code(copy, tmp_path):
  file, twin = tmp_path / "cable_pull.py", tmp_path / "twin.toml"
  file.write_text(SOURCE, encoding="utf-8")
  save = f"""
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.mechanisms import add_file, select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR
add_file({str(file)!r})
twin = Twin(QCAR, select(["cable_pull"]), threads=1)
save_twin({str(twin)!r}, twin, twin.parameters.vector({{"cable_pull": 2.0}}))
"""
  load = f"""
from qcar_twin.twin.file import load_twin
try:
  load_twin({str(twin)!r})
except ValueError as error:
  print(error)
"""
  if not (copy.folder / PATH).exists():
    copy.python("-c", save)
    said = copy.python("-c", load)
    assert "no mechanism 'cable_pull'" in said and "add_file" in said
    driven = ("-m", "scripts", "track", "--twin", str(twin), "--path", "o", "--estimator", "truth", "--quick")
    out = ("--out", str(tmp_path / "tracked"), "--mechanism-files", str(file))
    assert copy.python(*driven, *out).startswith("lq_cm tuned on o: ME ")


def test_one_file_in_the_package_is_all_it_takes(copy):
  (copy.folder / PATH).write_text(SOURCE, encoding="utf-8")
  assert copy.touched() == {PATH}
  assert copy.python("-c", _SEEN).strip() == "seen"
  assert copy.tests("tests/qcar_twin/twin/mechanisms/test_contract.py", "-k", "cable_pull or every_file") >= 15
  copy.python("-m", "qcar_twin.twin.mechanisms.document", "docs/reference/mechanisms.md")
  assert copy.touched() == {PATH, "docs/reference/mechanisms.md"}  # the page is generated
  assert "### cable_pull" in (copy.folder / "docs/reference/mechanisms.md").read_text(encoding="utf-8")


def test_a_named_file_is_run_by_the_diagnosis_and_refused_with_a_reason(tmp_path):
  file = tmp_path / "empty.py"
  file.write_text("x = 1\n", encoding="utf-8")
  command = [sys.executable, "-m", "scripts", "diagnose", "--dataset", str(tmp_path), "--out", str(tmp_path)]
  command += ["--mechanism-files", str(file)]
  environment = os.environ | {"PYTHONPATH": str(ROOT)}
  done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
  assert done.returncode != 0 and "empty.py: defines no mechanism" in done.stderr
