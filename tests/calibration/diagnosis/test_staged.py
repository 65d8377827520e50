"""What is ready lies on disk while the rest runs, and goes when the results stand."""

import json

from calibration.diagnosis.decision.decide import decide
from calibration.diagnosis.decision.evidence import FILE, read_evidence
from calibration.diagnosis.outcome import Outcome
from calibration.diagnosis.report import page
from calibration.diagnosis.search.gather import gather
from calibration.diagnosis.staged import FOLDER, NOWHERE, RANKING, Staged
from calibration.fitting.windows import Cut
from qcar_twin.twin.file import command_shift_of, load_twin
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests.calibration.diagnosis.diagnosis_results import diagnosis_of


def test_what_is_ready_can_be_read_and_gone_on_with(offset_pool, tmp_path):
  staged, folder = Staged(tmp_path), tmp_path / FOLDER
  twin = Twin(Vehicle.load(), select(["steering_offset"]), threads=1)
  theta = twin.parameters.nominal
  theta[twin.parameters.index("mass")] *= 1.01
  staged.base(twin, theta, -1)
  again, values = load_twin(folder / "recalibrated.toml")
  assert command_shift_of(folder / "recalibrated.toml") == -1  # else it would be driven a period late
  assert again.parameters.named(values)["mass"] == theta[twin.parameters.index("mass")]
  staged.scanned(offset_pool.signatures)
  told = json.loads((folder / RANKING).read_text())
  assert (told["stage"], told["claims"], told["ranking"][0]["mechanism"]) == ("scan", [], "steering_offset")
  evidence = gather(offset_pool)
  staged.weighed(evidence, decide(evidence))
  told = json.loads((folder / RANKING).read_text())
  assert told["stage"] == "search" and told["claims"][0]["mechanism"] == "steering_offset"
  assert read_evidence(folder / FILE) == evidence
  staged.end()
  assert not folder.exists()


def test_a_whole_diagnosis_lies_there_while_a_formula_is_sought(offset_pool, tmp_path, monkeypatch):
  saved = []  # the linear car is no twin that a file can hold
  monkeypatch.setattr(page, "save_twin", lambda path, *twin: saved.append(path.name))
  diagnosis, pool = diagnosis_of(offset_pool, ["steering_offset"]), offset_pool
  Staged(tmp_path).concluded(Outcome(diagnosis, pool.problem.twin, pool.base.theta, diagnosis.model.theta, Cut()))
  told = json.loads((tmp_path / FOLDER / "diagnosis.json").read_text())
  assert told["verdict"] == "explained" and (tmp_path / FOLDER / "report.html").stat().st_size > 10_000
  assert saved == ["recalibrated.toml", "twin.toml"]


def test_what_another_run_left_is_not_taken_for_this_one(offset_pool, tmp_path):
  """A run that was stopped after its search left evidence; the next one, stopped in its scan, has none."""
  evidence, twin = gather(offset_pool), Twin(Vehicle.load(), select([]), threads=1)
  Staged(tmp_path).weighed(evidence, decide(evidence))
  (tmp_path / FOLDER / "report.html").write_text("of its diagnosis")
  Staged(tmp_path).base(twin, twin.parameters.nominal, 0)
  assert [file.name for file in (tmp_path / FOLDER).iterdir()] == ["recalibrated.toml"]


def test_nowhere_nothing_is_written(offset_pool, tmp_path, monkeypatch):
  monkeypatch.chdir(tmp_path)
  NOWHERE.scanned(offset_pool.signatures)
  NOWHERE.end()
  assert list(tmp_path.iterdir()) == []
