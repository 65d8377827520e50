"""Evaluation: cases, contestants, seeds brought together, what is written, and work on several processes."""

import dataclasses
import json

import numpy as np
import pytest

from agents.control.kpis import Kpis, kpis
from agents.learning.evaluate import (
  EvaluationCase,
  Row,
  contestants,
  evaluate,
  in_words,
  known_plant,
  run_case,
  summary,
  write_evaluation,
)
from agents.learning.policy_file import save_policy
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests.agents.learning.test_train import GOOD

SHORT = "random:1:2"  # 3 m, a turn between straights
CASE = EvaluationCase(SHORT, "bicycle", cars=2, estimator="truth")


@pytest.fixture(scope="module")
def plain():
  """Indicators of the drive of `CASE`."""
  return kpis(run_case(GOOD, CASE))


@pytest.fixture
def folder(tmp_path):
  save_policy(GOOD, tmp_path / "policy")
  return tmp_path / "policy"


def indicators(rmse, finished=True):
  one, many = np.ones(len(rmse)), np.asarray(rmse, dtype=float)
  ok = one > 0 if finished else np.isfinite(many)
  return Kpis(2.0 * many, many, 0.1 * one, one, ok, ok)


def test_contestants_are_all_controllers_and_the_policies():
  names = list(contestants({}, 0.5))
  for name in ("ff_fb loose", "lq_ed tuned", "lq_cm tuned", "linear_rate tuned"):
    assert name in names
  slow, fast = (contestants({}, speed)["lq_cm tuned"].gain for speed in (0.3, 1.2))
  assert not np.allclose(slow, fast)


def test_a_row_is_the_drive_of_its_case(folder, plain):
  rows = evaluate({"net": folder}, [CASE], versions=())
  assert [row.contestant for row in rows] == ["net"]
  np.testing.assert_array_equal(rows[0].kpis.rmse, plain.rmse)


def test_baselines_come_along(folder):
  case = EvaluationCase(SHORT, "bicycle", speed=1.0, cars=1, estimator="truth")
  rows = evaluate({"net": folder}, [case], versions=("tuned",))
  names = ["ff_fb tuned", "lq_ed tuned", "lq_cm tuned", "linear_rate tuned", "net"]
  assert [row.contestant for row in rows] == names
  rmse = {row.contestant: row.kpis.rmse[0] for row in rows}
  assert rmse["lq_cm tuned"] < rmse["net"]


def test_mismatch_sensors_and_plant_reach_the_drive(plain):
  bent = kpis(run_case(GOOD, dataclasses.replace(CASE, steering_offset=5.0)))
  assert abs(bent.iaca[0] - plain.iaca[0]) > 0.01  # the command takes up what the linkage is off
  noisy = kpis(run_case(GOOD, dataclasses.replace(CASE, estimator="fekf")))
  assert noisy.rmse[0] != noisy.rmse[1] and plain.rmse[0] == plain.rmse[1]
  asked = []

  def ground(name):
    asked.append(name)
    plant, theta = known_plant("bicycle")
    assert isinstance(plant, Bicycle)
    return plant, theta

  run_case(GOOD, EvaluationCase(SHORT, "ground", speed=1.0, cars=1, estimator="truth"), ground)
  assert asked == ["ground"]


def test_sensors_of_a_known_twin_leave_the_simulated_ones_as_they_are(tmp_path):
  twin = Twin(Vehicle.load(), select(["gyro_bias"]), threads=1)
  theta = twin.parameters.vector({"gyro_bias": 0.1, "servo_time_constant": 0.05})
  file = save_twin(tmp_path / "twin.toml", twin, theta)
  plain = dataclasses.replace(CASE, estimator="fekf", cars=1)  # the bicycle's filter is told of a lag of 0.05 s
  known = run_case(GOOD, dataclasses.replace(plain, known_from=str(file)))
  np.testing.assert_allclose(known.cross_track, run_case(GOOD, plain).cross_track)


def test_summary_takes_medians_and_quartiles_over_cars_and_seeds():
  rows = [Row(f"net {k}", CASE, indicators([0.001 * k, 0.001 * k + 0.010])) for k in range(1, 6)]
  (entry,) = summary(rows, lambda label: label.split()[0])
  values = np.concatenate([row.kpis.rmse for row in rows])
  assert entry["contestant"] == "net" and entry["trainings"] == 5
  assert entry["rmse"] == pytest.approx(np.median(values))
  assert entry["rmse_quartiles"] == pytest.approx(np.quantile(values, [0.25, 0.75]).tolist())
  assert entry["me"] == pytest.approx(2.0 * np.median(values)) and entry["inside"] == 1.0
  assert len(summary(rows)) == 5


def test_a_run_that_left_the_path_is_said_so(tmp_path):
  rows = [Row("net", CASE, indicators([np.inf, np.inf, 0.01], finished=False))]
  (entry,) = summary(rows)
  assert entry["rmse"] is None and entry["finished"] == pytest.approx(1 / 3)
  assert "left" in in_words([entry])
  write_evaluation(tmp_path, rows)
  stored = json.loads((tmp_path / "evaluation.json").read_text())
  assert stored["runs"][0]["rmse"] == [None, None, 0.01]


def test_what_is_written(tmp_path):
  rows = [
    Row(name, EvaluationCase(path, steering_gain=gain), indicators([0.004, 0.006]))
    for name in ("ddpg", "lq_ed tuned")
    for path in ("o", "c")
    for gain in (1.0, 0.92)
  ]
  text = write_evaluation(tmp_path, rows)
  assert sorted(p.name for p in tmp_path.iterdir()) == [
    "evaluation.json",
    "evaluation.txt",
    "indicators_0.png",
    "indicators_1.png",
  ]
  assert "gain 0.92" in text and "5.0 [" in text and (tmp_path / "evaluation.txt").read_text().strip() == text
  stored = json.loads((tmp_path / "evaluation.json").read_text())
  assert len(stored["summary"]) == 8 and len(stored["runs"]) == 8
