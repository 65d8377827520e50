"""What is searched with: MuJoCo's own answer at its anchor, nearly so around it."""

import dataclasses

import numpy as np
import pytest

from calibration.fitting.surrogate import Surrogate, anchored, exact, searching
from qcar_twin.plant import SIGNALS, START, Segments
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

CAR = Vehicle.load()
TIME = 0.01 * np.arange(200)
COMMANDS = np.stack(
  [
    np.stack([1.2 + 0.0 * TIME, 0.15 * np.sin(4.0 * TIME)], axis=-1),
    np.stack([1.0 + 0.5 * np.sign(np.sin(3.0 * TIME)), 0.1 + 0.0 * TIME], axis=-1),
    np.stack([np.where(TIME < 1.0, 1.5, 0.5), 0.0 * TIME], axis=-1),
  ]
)
SEGMENTS = Segments(
  COMMANDS, np.zeros((3, len(START))), np.full(3, 200), 0.01, ("slalom", "turn", "brake"), np.zeros(3)
)


@pytest.fixture(scope="module")
def twin() -> Twin:
  return Twin(CAR, select(["gyro_scale", "payload"]), substeps=2, threads=1)


def moved(twin: Twin, share: float) -> np.ndarray:
  theta = twin.parameters.nominal
  theta[: len(twin.base)] += share * twin.base.scale
  return theta


def test_at_its_anchor_it_is_mujoco(twin):
  anchor = moved(twin, 0.3)
  signals = Surrogate(twin).at(anchor).rollout(anchor, SEGMENTS).signals
  np.testing.assert_allclose(signals, twin.rollout(anchor, SEGMENTS).signals, atol=1e-9)


def test_around_it_the_correction_takes_most_of_the_error_away(twin):
  anchor, theta = moved(twin, 0.3), moved(twin, 0.35)
  truth = twin.rollout(theta, SEGMENTS).signals
  wrong = lambda plant: np.sqrt(np.mean((plant.rollout(theta, SEGMENTS).signals - truth) ** 2, axis=(0, 1, 2)))
  plain, corrected = wrong(Surrogate(twin)), wrong(Surrogate(twin).at(anchor))
  for name in ("yaw_rate", "velocity_x", "motor_speed", "accel_y"):
    assert corrected[SIGNALS.index(name)] < 0.4 * plain[SIGNALS.index(name)]


def test_sensors_err_after_the_correction(twin):
  theta = twin.parameters.nominal
  scaled = theta.copy()
  scaled[twin.parameters.index("gyro_scale")] = 0.1
  surrogate = Surrogate(twin).at(theta)
  both = surrogate.rollout(np.stack([theta, scaled]), SEGMENTS).signals
  rate = SIGNALS.index("yaw_rate")
  np.testing.assert_allclose(both[1, ..., rate], 1.1 * both[0, ..., rate], atol=1e-12)


def test_with_a_mechanism_more_that_is_at_its_null_mujoco_is_not_asked_again(twin, monkeypatch):
  less = Surrogate(twin.with_mechanisms(select(["gyro_scale"]))).at(moved(twin, 0.3)[:-2])
  theta = moved(twin, 0.35)
  theta[twin.parameters.index("payload_mass")] = 0.2
  expected = Surrogate(twin).at(moved(twin, 0.3)).rollout(theta, SEGMENTS).signals
  less.rollout(less.anchor, SEGMENTS)
  monkeypatch.setattr(twin, "simulate", None)
  more = less.standing_in(twin)
  np.testing.assert_array_equal(more.rollout(theta, SEGMENTS).signals, expected)
  assert more.at(moved(twin, 0.3)) is more and more.at(theta) is not more


def test_a_guarded_stretch_is_mujocos_whatever_the_parameters(twin):
  theta = moved(twin, 0.5)
  surrogate = Surrogate(twin).at(twin.parameters.nominal).guarding([("brake", 0.0)])
  signals, truth = surrogate.rollout(theta, SEGMENTS).signals[0], twin.rollout(theta, SEGMENTS).signals[0]
  np.testing.assert_array_equal(signals[2], truth[2])
  assert np.abs(signals[0] - truth[0]).max() > 0.0


def test_mujoco_drives_the_anchor_once_per_stretch_whatever_is_asked_of_it(twin, monkeypatch):
  surrogate = Surrogate(twin).at(twin.parameters.nominal)
  seen = []
  simulate = Twin.simulate
  monkeypatch.setattr(
    Twin,
    "simulate",
    lambda self, theta, s: (
      seen.append(len(s)) or simulate(self, theta, s) if self is twin else simulate(self, theta, s)
    ),
  )
  for which in (slice(0, 1), slice(0, 3), slice(1, 3)):
    surrogate.rollout(moved(twin, 0.1), SEGMENTS[which])
  assert seen == [1, 2]


def test_another_anchor_leaves_the_first_as_it_was(twin):
  theta = twin.parameters.nominal
  first = Surrogate(twin).at(theta)
  before = first.rollout(theta, SEGMENTS).signals
  first.at(moved(twin, 0.3)).rollout(theta, SEGMENTS)
  np.testing.assert_array_equal(first.rollout(theta, SEGMENTS).signals, before)


def test_where_the_reduced_car_cannot_stand_in_mujoco_searches_and_it_is_said(twin):
  same, said = searching(twin, "mujoco")
  assert same is twin and said == ()
  searched, said = searching(twin)
  assert isinstance(searched, Surrogate) and exact(searched) is twin and exact(twin) is twin and said == ()
  rolling = Twin(dataclasses.replace(CAR, rolling_resistance=0.01), substeps=2, threads=1)
  same, said = searching(rolling)
  assert same is rolling and "on MuJoCo alone" in said[0] and "it lacks rolling resistance" in said[0]


def test_anchored_at_some_parameters_the_others_are_nominal(twin):
  surrogate = anchored(Surrogate(twin), ["mass"], np.array([2.9]))
  assert isinstance(surrogate, Surrogate) and surrogate.anchor is not None
  np.testing.assert_array_equal(surrogate.anchor, twin.parameters.vector({"mass": 2.9}))
  assert anchored(twin, ["mass"], np.array([2.9])) is twin
