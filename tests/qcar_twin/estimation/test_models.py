"""The filters' motion models: the single track's equations, exact Jacobians, sane at rest and in reverse."""

import math
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qcar_twin import kinematics
from qcar_twin.bicycle import single_track
from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation import models

CAR = SingleTrackCar(4800.0, 8.0, 1600.0, 150.0, 210.0, 2.7, 0.030, 0.120, 0.136, 0.0953668 * 0.033)
states = st.tuples(
  st.floats(-3, 3), st.floats(-3, 3), st.floats(-2.5, 2.5), st.floats(-7, 7), st.floats(-0.4, 0.4), st.floats(-4, 4)
)


def step(state, voltage, steering, period=0.01, car=CAR):
  return np.array(models.bicycle_step(tuple(state), voltage, steering, car, period)[0])


def jacobian(state, voltage, steering, period=0.01, car=CAR):
  out = np.eye(6)
  models.fill_jacobian(out, models.bicycle_step(tuple(state), voltage, steering, car, period)[1], period)
  return out


def near_friction_kink(state, voltage, period=0.01):
  free = state[2] + period * (CAR.rolling_radius * CAR.drive_gain * voltage - CAR.drive_damping * state[2])
  return abs(abs(free) - period * CAR.rolling_radius * CAR.drive_friction) < 1e-4


@settings(max_examples=200, deadline=None)
@given(states, st.floats(-3, 3), st.floats(-0.5, 0.5))
def test_jacobian_against_finite_differences(state, voltage, steering):
  if near_friction_kink(state, voltage):
    return
  h, state = 1e-6, np.array(state)
  columns = [
    (step(state + h * e, voltage, steering) - step(state - h * e, voltage, steering)) / (2 * h) for e in np.eye(6)
  ]
  np.testing.assert_allclose(jacobian(state, voltage, steering), np.stack(columns, axis=1), atol=2e-6, rtol=2e-6)


@settings(max_examples=100, deadline=None)
@given(states, st.floats(-3, 3), st.floats(-0.5, 0.5))
def test_small_steps_follow_the_single_track(state, voltage, steering):
  """(x(h) - x) / h -> f(x): the same equations as the Bicycle plant's, above its low-speed blend."""
  state = np.array(state)
  if abs(state[2]) < single_track.LOW_SPEED or near_friction_kink(state, voltage, 1e-7):
    return
  with mock.patch.object(models, "STANDSTILL", 1e-9):  # without the smoothing of |v|
    rate = (step(state, voltage, steering, period=1e-7) - state) / 1e-7
  expected = single_track.derivative(state, np.array([voltage, steering]), CAR)
  np.testing.assert_allclose(rate, expected, rtol=1e-3, atol=1e-2)


def test_settles_where_the_single_track_settles():
  """At 0.5 and 2 m/s the steady sideslip and yaw rate are the exact steady cornering."""
  for speed in (0.5, 2.0):
    voltage = (CAR.drive_damping * speed / CAR.rolling_radius + CAR.drive_friction) / CAR.drive_gain
    state = np.array([0.0, 0.0, speed, 0.0, 0.0, 0.0])
    for _ in range(300):
      state = step(state, voltage, 0.05)
    numbers = CAR.mass, CAR.cg_to_front, CAR.cg_to_rear
    stiffness = CAR.cornering_stiffness_front, CAR.cornering_stiffness_rear
    gradient = kinematics.understeer_gradient(*numbers, *stiffness)
    gain = kinematics.yaw_rate_gain(speed, CAR.cg_to_front + CAR.cg_to_rear, gradient)
    slip = kinematics.sideslip_gain(speed, *numbers, stiffness[1], gradient)
    assert state[2] == pytest.approx(speed, rel=1e-9)
    assert state[5] == pytest.approx(0.05 * gain, rel=2e-3)
    assert state[4] == pytest.approx(0.05 * slip, rel=2e-3, abs=1e-5)


@pytest.mark.parametrize("speed", [1e-3, 0.01, -0.01])
def test_slow_car_moves_as_its_wheels_roll(speed):
  state = np.array([0.0, 0.0, speed, 0.0, 0.0, 0.0])
  hold = (CAR.drive_damping * speed / CAR.rolling_radius + math.copysign(CAR.drive_friction, speed)) / CAR.drive_gain
  for _ in range(50):
    state = step(state, hold, 0.2)
  wheelbase = CAR.cg_to_front + CAR.cg_to_rear
  assert state[4] == pytest.approx(CAR.cg_to_rear * 0.2 / wheelbase, rel=0.05)
  assert state[5] == pytest.approx(speed * 0.2 / wheelbase, rel=0.05)


def test_car_at_rest_stays_at_rest_below_breakaway():
  breakaway = CAR.drive_friction / CAR.drive_gain
  state = np.zeros(6)
  for _ in range(200):
    state = step(state, 0.95 * breakaway, 0.3)
  assert state[2] == 0.0 and abs(state[5]) < 1e-12 and np.all(state[:2] == 0.0)
  assert step(np.zeros(6), 1.5 * breakaway, 0.0)[2] > 0.0


def test_friction_stops_but_never_reverses():
  state = np.array([0.0, 0.0, 0.03, 0.0, 0.0, 0.0])
  speeds = []
  for _ in range(20):
    state = step(state, 0.0, 0.0)
    speeds.append(state[2])
  assert speeds[-1] == 0.0 and min(speeds) == 0.0


def test_reverse_is_the_mirror_image_in_time_of_rolling():
  """Slow reverse with left lock: the tail goes left, the yaw rate is negative, beta keeps its sign."""
  state = np.array([0.0, 0.0, -0.3, 0.0, 0.0, 0.0])
  hold = (CAR.drive_damping * -0.3 / CAR.rolling_radius - CAR.drive_friction) / CAR.drive_gain
  for _ in range(100):
    state = step(state, hold, 0.1)
  assert state[2] == pytest.approx(-0.3, rel=1e-6)
  assert state[5] < 0.0 < state[4]


@settings(max_examples=50, deadline=None)
@given(states, st.floats(-3, 3), st.floats(-0.5, 0.5))
def test_mirrored_inputs_give_mirrored_motion(state, voltage, steering):
  mirror = np.array([1, -1, 1, -1, -1, -1])
  np.testing.assert_allclose(
    step(np.array(state) * mirror, voltage, -steering), step(state, voltage, steering) * mirror, atol=1e-12
  )


def test_many_cars_are_as_one():
  rng = np.random.default_rng(0)
  x = rng.normal(size=(40, 6))
  u = rng.normal(size=(40, 2))
  many, entries = models.bicycle_step(tuple(x.T), u[:, 0], u[:, 1], CAR, 0.01, np)
  jac = np.tile(np.eye(6), (40, 1, 1))
  models.fill_jacobian(jac, entries, 0.01)
  for i in range(40):
    np.testing.assert_allclose(np.array(many)[:, i], step(x[i], *u[i]), rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(jac[i], jacobian(x[i], *u[i]), rtol=1e-12, atol=1e-13)


def test_point_model_is_exact_under_constant_acceleration():
  state, yaw, accel = (0.0, 0.0, 0.3, -0.1), 0.7, (0.4, -0.9)
  for _ in range(100):
    state = models.point_step(state, accel, yaw, 0.01)
  ax = accel[0] * math.cos(yaw) - accel[1] * math.sin(yaw)
  ay = accel[0] * math.sin(yaw) + accel[1] * math.cos(yaw)
  assert state == pytest.approx((0.3 + 0.5 * ax, -0.1 + 0.5 * ay, 0.3 + ax, -0.1 + ay), abs=1e-12)


def test_lever_arm_is_taken_off_in_a_steady_turn():
  at_imu = kinematics.transport_acceleration(0.1, 0.8, 1.7, 0.0, 0.05, -0.02)
  np.testing.assert_allclose(models.cg_acceleration(at_imu, 1.7, (0.05, -0.02)), (0.1, 0.8), atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(states, st.floats(-0.5, 0.5))
def test_lateral_acceleration_slopes(state, steering):
  h, state = 1e-6, np.array(state)
  _, slopes = models.lateral_acceleration(tuple(state), steering, CAR)
  for slope, i in zip(slopes, (2, 4, 5), strict=True):
    up, down = (models.lateral_acceleration(tuple(state + d * np.eye(6)[i]), steering, CAR)[0] for d in (h, -h))
    assert slope == pytest.approx((up - down) / (2 * h), rel=1e-4, abs=1e-4)


def test_lateral_acceleration_is_the_single_tracks():
  state = np.array([0.0, 0.0, 0.8, 0.3, 0.05, 0.9])
  value, _ = models.lateral_acceleration(tuple(state), 0.1, CAR)
  rates = single_track.derivative(state, np.array([0.0, 0.1]), CAR)
  expected = 0.8 * (rates[4] + 0.9) + rates[2] * 0.05  # v (beta' + r) + v' beta, small angles
  assert value == pytest.approx(expected, rel=2e-3)


def test_smoothing_speed_matters_only_near_rest():
  assert math.sqrt(0.5**2 + models.STANDSTILL**2) / 0.5 - 1.0 < 1e-3
