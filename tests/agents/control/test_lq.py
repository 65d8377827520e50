"""LQ design: the error model against the plant, the Riccati equation against its own optimality, steady curves."""

import numpy as np
import pytest

from agents.control.interface import Situation
from agents.control.lq import LqCm, LqEd, discrete_error_model, error_model, lq_gain, steady_curve
from agents.control.team import Team
from qcar_twin import kinematics
from qcar_twin.paths import Errors, path_from_pieces, turn
from tests.agents.control.tracking_rig import CAR, PLANT, THETA, follow

WEIGHTS, EFFORT = (1.0, 0.1, 0.1, 0.01), 0.05


def situation(errors, curvature=0.0):
  errors = np.atleast_2d(np.asarray(errors, dtype=float))
  count = len(errors)
  full = np.full(count, 1.0)
  parts = Errors(*errors.T, arc_rate=0.5 * full, curvature=curvature * full)
  path = path_from_pieces("line", [(1.0, 0.0, 0.0)])
  return Situation(path, 0.0 * full, parts, 0.5 * full, 0.0 * full, 0.01)


@pytest.mark.parametrize("speed", [0.5, 1.5])
def test_error_model_is_the_linearised_plant(speed):
  """A small steer about straight driving: the plant's lateral motion is the linear model's."""
  start = np.zeros((1, 7))
  start[0, 3] = speed
  simulation = PLANT.begin(THETA[None], start)
  hold = (CAR.drive_damping * speed / CAR.rolling_radius + CAR.drive_friction) / CAR.drive_gain
  a, b = discrete_error_model(CAR, speed, 0.01)
  x, steering = np.zeros(4), 1e-3
  for _ in range(60):
    signals = simulation.step(np.array([[hold, steering]]))
    x = a @ x + b[:, 0] * steering
  y, yaw, rate = signals[0, 1], signals[0, 2], signals[0, 5]
  lateral = signals[0, 4] + speed * yaw
  np.testing.assert_allclose(x, [y, lateral, yaw, rate], rtol=2e-3)


def test_discrete_model_is_the_continuous_one_for_short_steps():
  matrix, steering, _ = error_model(CAR, 0.5)
  a, b = discrete_error_model(CAR, 0.5, 1e-6)
  np.testing.assert_allclose((a - np.eye(4)) / 1e-6, matrix, rtol=1e-3, atol=1e-2)
  np.testing.assert_allclose(b[:, 0] / 1e-6, steering, rtol=1e-3, atol=1e-2)


def cost(gain, x):
  a, b = discrete_error_model(CAR, 0.5, 0.01)
  total = 0.0
  for _ in range(3000):
    u = -gain @ x
    total += x @ np.diag(WEIGHTS) @ x + EFFORT * u**2
    x = a @ x + b[:, 0] * u
  return total


def test_no_nearby_gain_is_cheaper():
  gain, x = lq_gain(CAR, 0.5, WEIGHTS, EFFORT), np.array([0.05, 0.0, 0.1, 0.0])
  best = cost(gain, x)
  rng = np.random.default_rng(0)
  assert all(cost(gain * (1.0 + 0.1 * rng.standard_normal(4)), x) >= best for _ in range(20))


@pytest.mark.parametrize("effort", [1e-3, 0.05, 1.0])
def test_closed_loop_is_stable(effort):
  gain = lq_gain(CAR, 0.5, WEIGHTS, effort)
  a, b = discrete_error_model(CAR, 0.5, 0.01)
  assert np.abs(np.linalg.eigvals(a - b @ gain[None])).max() < 1.0
  assert gain[0] > 0.0 and gain[2] > 0.0  # steers back towards the path


def test_cheaper_steering_steers_harder():
  gains = [lq_gain(CAR, 0.5, WEIGHTS, effort)[0] for effort in (1.0, 0.1, 0.01)]
  assert gains[0] < gains[1] < gains[2]


def test_impossible_weights_are_refused():
  with pytest.raises(ValueError, match="weights must be"):
    lq_gain(CAR, 0.5, (0.0, 1.0, 1.0, 1.0), 1.0)
  with pytest.raises(ValueError, match="effort positive"):
    lq_gain(CAR, 0.5, WEIGHTS, 0.0)


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_steady_curve_is_steady_cornering(speed):
  """Steering L + K v^2 and heading error -beta per curvature: the closed forms of the single track."""
  delta, heading = steady_curve(CAR, speed)
  numbers = CAR.mass, CAR.cg_to_front, CAR.cg_to_rear
  gradient = kinematics.understeer_gradient(*numbers, CAR.cornering_stiffness_front, CAR.cornering_stiffness_rear)
  assert delta == pytest.approx(CAR.cg_to_front + CAR.cg_to_rear + gradient * speed**2, rel=1e-12)
  slip = kinematics.sideslip_gain(speed, *numbers, CAR.cornering_stiffness_rear, gradient)
  assert heading == pytest.approx(-slip * delta, rel=1e-12)


def test_lq_ed_is_a_linear_feedback():
  controller = LqEd.design(CAR, 0.5, WEIGHTS, EFFORT)
  x = np.array([[0.1, -0.2, 0.05, 0.3]])
  assert controller.steer(situation(x))[0] == pytest.approx(-controller.gain @ x[0])


def test_lq_cm_leaves_no_error_in_a_long_curve_and_lq_ed_does():
  """In a constant curve of 1 m radius Snider's feed-forward leaves less than half a millimetre."""
  bend = path_from_pieces("bend", [(0.3, 0.0, 0.0), *turn(4.0, 1.0, 0.5)[:2]])
  both = Team(tuple(kind.design(CAR, 0.5, WEIGHTS, EFFORT) for kind in (LqCm, LqEd)), 1)
  compensated, plain = np.abs(follow(both, bend, count=2).cross_track[-40])
  assert compensated < 5e-4 < plain


def test_gains_per_car_are_used_per_car():
  gain = np.array([[1.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0]])
  x = np.array([[0.1, 0, 0, 0], [0.1, 0, 0, 0]])
  assert LqEd(gain).steer(situation(x)).tolist() == pytest.approx([-0.1, -0.2])
