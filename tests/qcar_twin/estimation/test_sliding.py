"""A car whose tyres have given way is led by accelerometer and gyro: what it does then, and when it is not."""

import math

import numpy as np
import pytest

from agents.control.model import Model
from agents.studies.filtering.acceptance_study import LIMIT, Case, Driven, judge, limit_drive
from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.models import BETA, R, V
from qcar_twin.estimation.watches.model import ModelWatch
from qcar_twin.estimation.watches.watching import slide
from scripts.benchmark_filter import subject

PERIOD = 0.001


def inertial(v, yaw, beta):
  """Velocity in the room, m/s."""
  return np.array([v * math.cos(yaw + beta), v * math.sin(yaw + beta)])


@pytest.mark.parametrize(("speed", "rate"), [(3.0, 1.5), (-3.0, 1.5), (3.0, 12.0)])
def test_it_moves_as_its_acceleration_says(speed, rate):
  """The body turns under a car that its acceleration pushes otherwise, forward, in reverse and through a spin; Euler's
  error only."""
  state, yaw = np.array([0.0, 0.0, speed, 0.0, 0.4, rate]), 0.0
  room = inertial(speed, yaw, 0.4)
  for k in range(500):
    felt = 4.0 * math.cos(0.01 * k), 6.0
    cos, sin = math.cos(yaw), math.sin(yaw)
    room = room + PERIOD * np.array([cos * felt[0] - sin * felt[1], sin * felt[0] + cos * felt[1]])
    slide(state, np.eye(6), state.tolist(), felt, PERIOD)
    yaw += PERIOD * state[R]
    assert abs(state[BETA]) <= 0.5 * math.pi
  assert inertial(state[V], yaw, state[BETA]) == pytest.approx(room, abs=0.03)


def test_its_jacobian_is_the_derivative():
  before, felt, tiny = [0.0, 0.0, -2.5, 0.0, 0.5, -2.0], (-3.0, 6.0), 1e-6
  transition, following = np.ones((6, 6)), np.array(before)
  slide(following, transition, before, felt, 0.01)
  for column in (V, BETA, R):
    moved, there = list(before), np.array(before)
    moved[column] += tiny
    slide(there, np.eye(6), moved, felt, 0.01)
    slope = (there - following)[[V, BETA, R]] / tiny
    assert transition[[V, BETA, R], column] == pytest.approx(slope, abs=1e-5)
  assert not transition[[V, BETA, R], :2].any()


def test_a_standing_car_that_is_lifted_and_tilted_does_not_slide():
  """Gravity in the accelerometer of a car at rest: no course can be told from it."""
  online = FederatedFilter(Model.nominal().car)
  for k in range(300):
    now = 0.01 * k
    said = {"motor_voltage": 0.0, "steering_command": 0.0, "motor_speed": 0.0, "yaw_rate": 0.0, "accel_x": 0.0}
    said["accel_y"] = 9.81 * math.sin(0.4 * min(1.0, max(0.0, now - 1.0)))
    if k % 10 == 0:
      said |= {"pose_x": 0.0, "pose_y": 0.0, "pose_yaw": 0.0, "pose_score": 100.0}
    for channel, value in said.items():
      online.update(now, channel, value)
    estimate = online.estimate(now)
  assert estimate.valid and math.hypot(estimate.pose_x, estimate.pose_y) < 0.05
  assert abs(estimate.sideslip_angle) < 0.1 and not estimate.warnings


@pytest.mark.parametrize(
  ("felt", "steering", "turn", "slides"), [(6.5, 0.18, 0.3, True), (6.5, 0.3, 0.3, True), (6.5, 0.3, 0.1, False)]
)
def test_what_is_steered_for_beyond_grip_excuses_no_slide(felt, steering, turn, slides):
  """In reverse at 3 m/s: linear tyres explain the push, but not that the car turns by so much, rad/s, in a period."""
  car, watch, period = Model.nominal().car, ModelWatch(), 0.01
  for _ in range(50):
    watch.feel(felt, felt, period)
    watch.judge(turn, True, period)
    watch.weigh(-3.0, steering, car, period)
  assert watch.gives and watch.sliding == slides


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), [("first", 22), ("second", 11), ("second", 21)])
def test_cars_that_spin_their_wheels_in_reverse_are_followed(name, seed):
  """Sideslip of up to 50 degrees, wheels up to a third faster than the car: neither tyres nor encoder tell of it."""
  car = subject(name, seed)
  driven = limit_drive(car)
  back = LIMIT[:, 0] < 0.0
  outcome = judge(car, Driven(driven.signals[:, back], driven.commands[:, back]), Case())
  assert outcome.falsely(Case()) == 0 and outcome.valid.mean() > 0.97
  assert outcome.beyond <= 0.05 and np.nanmax(outcome.position) < 0.1
