"""Controllers side by side in one simulation: each drives as it would alone, with the same noise as the others."""

import numpy as np
import pytest

from agents.control import controllers
from agents.control.external_plant import ExternalPlant
from agents.control.feedforward import FeedforwardFeedback
from agents.control.kpis import kpis
from agents.control.model import Model
from agents.control.team import EqualSensors, Team
from agents.learning.evaluate import EvaluationCase, contestants, run_case, run_together
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.plant import SIGNALS
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors
from qcar_twin.tracks import path_from
from tests.agents.control.tracking_rig import CAR, follow
from tests.agents.learning.test_train import GOOD

FIELDS = ("rmse", "me", "iaca", "steering_rate")
SHORT = "random:1:2"  # 3 m, a turn between straights


@pytest.mark.parametrize("estimator, plant", [("truth", "bicycle"), ("fekf", "reduced")])
def test_everybody_drives_as_alone(estimator, plant):
  case = EvaluationCase(SHORT, plant, speed=1.0, cars=2, estimator=estimator)
  members = {name: c for name, c in contestants({}, 1.0).items() if name in ("lq_cm tuned", "linear_rate tuned")}
  members["net"] = GOOD
  for row in run_together(members, case):
    alone = kpis(run_case(members[row.contestant], case))
    assert alone.finished.all(), row.contestant
    for field in FIELDS:
      np.testing.assert_allclose(getattr(row.kpis, field), getattr(alone, field), rtol=1e-9, err_msg=row.contestant)
    assert row.case == case and row.kpis.rmse.shape == (2,)


def test_one_that_leaves_the_path_does_not_pull_the_others_along():
  blind = FeedforwardFeedback(CAR, 0.0, 0.1)
  case = EvaluationCase(SHORT, "reduced", cars=1, estimator="truth", steering_offset=5.0)
  good = contestants({}, 0.5)["lq_cm tuned"]
  lost, kept = run_together({"blind": blind, "lq_cm": good}, case)
  assert not lost.kpis.finished[0] and kept.kpis.finished[0]
  np.testing.assert_allclose(kept.kpis.rmse, kpis(run_case(good, case)).rmse, rtol=1e-9)


def test_cars_of_equal_place_have_equal_noise():
  signals = np.tile(np.random.default_rng(0).uniform(0.1, 0.5, (2, len(SIGNALS))), (3, 1))
  equal, alone = EqualSensors(qcar_sensors(), 3, 2, seed=4), SensorSuite(qcar_sensors(), 2, seed=4)
  everyone = np.ones(6, dtype=bool)
  equal.restart(everyone, signals)
  alone.restart(everyone[:2], signals[:2])
  for _ in range(25):
    together, single = equal.measure(signals), alone.measure(signals[:2])
    for reading, reference in zip(together, single, strict=True):
      assert reading.channels == reference.channels and reading.age == reference.age
      for group in range(3):
        np.testing.assert_array_equal(reading.values[2 * group : 2 * group + 2], reference.values)


def test_a_team_of_one_kind_is_the_same_as_its_gains_side_by_side():
  table = controllers.load(CAR)
  pair = [table["lq_ed", "loose"], table["lq_ed", "tuned"]]
  team = follow(Team(tuple(pair), 2), path_from(SHORT), count=4)
  beside = follow(controllers.side_by_side(pair, 2), path_from(SHORT), count=4)
  np.testing.assert_allclose(team.cross_track, beside.cross_track, atol=1e-12)


def test_a_foreign_simulator_needs_no_parameters():
  model = Model.nominal()
  bicycle = Bicycle(model.vehicle)
  foreign = ExternalPlant(lambda start: bicycle.begin(np.tile(model.theta, (len(start), 1)), start))
  case = EvaluationCase(SHORT, "stranger", speed=1.0, cars=2, estimator="truth")
  foreigns = kpis(run_case(GOOD, case, lambda name: (foreign, np.empty(0))))
  own = kpis(run_case(GOOD, case, lambda name: (bicycle, model.theta)))
  np.testing.assert_array_equal(foreigns.rmse, own.rmse)
