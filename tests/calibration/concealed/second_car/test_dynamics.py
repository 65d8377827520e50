"""The second car: energy, steady states against closed forms, what the IMU feels, steps, the rubber's law."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.concealed.second_car.car import GRAVITY, SecondCar
from calibration.concealed.second_car.chassis import rest_loads
from calibration.concealed.second_car.simulation import SIGNALS, columns
from calibration.concealed.second_car.states import NAMES, State
from calibration.concealed.second_car.tyre import bristle_stiffness, patch, tyre_forces
from tests.calibration.concealed.second_car.second_car_rig import CAR, FREE, go

ROW = {name: i for i, name in enumerate(SIGNALS)}


def test_it_stands_still():
  simulation, _ = go([CAR], lambda _t: (0.0, 0.0), 0.3)
  state = simulation.state
  assert np.abs([state.u, state.v, state.w, state.motor, state.roll, state.pitch]).max() < 1e-9


def test_wheels_roll_where_they_are_at_a_start_in_a_turn():
  """About a point on the rear axle's line each moves as far as it is from there, with full Ackermann geometry."""
  car, radius, rate = replace(CAR, ackermann=1.0), 0.8, 1.5
  simulation, _ = go([car], lambda _t: (0.0, 0.0), 0.01)
  length = car.cg_to_front + car.cg_to_rear
  angle = np.arctan(length / radius)
  begun = np.array([[0.0, 0.0, 0.0, radius * rate, car.cg_to_rear * rate, rate, angle]])
  state = State(simulation.chassis.start(begun))
  chassis = simulation.chassis
  distance = np.hypot(chassis.corner_x + car.cg_to_rear, chassis.corner_y - radius)
  assert car.wheel_radius * state.wheel == pytest.approx(rate * distance, rel=1e-9)
  assert state.motor * car.gear_ratio == pytest.approx(state.wheel.mean(axis=0))


def test_terminal_speed_is_that_of_the_motor_equation():
  volts = np.array([0.8, 1.6, 2.4])
  per_speed, to_move = CAR.drive_line()
  start = (volts - to_move) / per_speed * CAR.gear_ratio * CAR.wheel_radius
  simulation, _ = go([CAR] * 3, lambda _t: (volts, 0.0), 1.5, speed=start)
  # drag, which the closed form leaves out: R / K of its torque at the motor
  force = CAR.drag * simulation.state.u**2 * CAR.gear_ratio * CAR.wheel_radius
  expected = (volts - to_move - CAR.motor_resistance / CAR.motor_constant * force) / per_speed
  assert simulation.state.motor == pytest.approx(expected, rel=4e-3)
  rolled = simulation.state.motor * CAR.gear_ratio * CAR.wheel_radius
  assert simulation.state.u == pytest.approx(rolled, rel=2e-3)  # a driven wheel slips a little
  assert np.all(simulation.state.u < rolled)


def test_understeer_gradient_is_that_of_the_axles():
  """delta = L / R + (1 / c_f - 1 / c_r) a_y / g, with stiffness over load c (Gillespie 1992, ch. 6)."""
  cars = [replace(CAR, cornering_front=8.0, cornering_rear=rear, ackermann=0.0) for rear in (8.0, 16.0)]
  angle = 0.05
  simulation, _ = go(cars, lambda _t: (1.3, angle), 2.0, speed=1.1, steer=angle)
  state = simulation.state
  lateral = state.u * state.r
  gradient = (angle - CAR.wheelbase * state.r / state.u) / lateral
  expected = np.array([0.0, 1 / 8 - 1 / 16]) / GRAVITY
  assert gradient[1] - gradient[0] == pytest.approx(expected[1], rel=0.1)
  assert gradient[0] == pytest.approx(0.0, abs=0.2 * expected[1])


def test_a_coasting_car_only_loses_energy():
  simulation, stored = go([CAR, CAR], lambda _t: (0.0, np.array([0.0, 0.15])), 0.6, speed=1.8, steer=0.0)
  assert np.diff(stored, axis=0).max() < 1e-6
  assert np.all(stored[-1] < 0.25 * stored[0])
  assert np.all(simulation.state.u > 0.0)


def test_without_friction_a_rolling_car_keeps_its_energy():
  _, stored = go([FREE], lambda _t: (0.0, 0.0), 0.5, speed=1.5)
  assert stored[-1] == pytest.approx(stored[0], rel=1e-3)


def test_the_imu_feels_the_motion_and_the_tilt():
  car = replace(CAR, imu_x=0.03, imu_y=0.01)
  simulation, _ = go([car], lambda t: (1.8, 0.15 * np.sin(8.0 * t)), 1.0, speed=1.2)
  trace = simulation.trace[:, :, 0].T
  step = 2e-3
  slope = lambda name: np.gradient(trace[ROW[name]], step)
  turn, spin = trace[ROW["yaw_rate"]], slope("yaw_rate")
  across = slope("vy") + turn * trace[ROW["vx"]] + spin * car.imu_x - turn**2 * car.imu_y
  along = slope("vx") - turn * trace[ROW["vy"]] - spin * car.imu_y - turn**2 * car.imu_x
  inner = slice(60, -5)
  # what is left is gravity in a chassis that leans outwards, in proportion to the acceleration
  leaning = np.polyfit(across[inner], trace[ROW["accel_y"]][inner], 1)[0]
  assert 1.01 < leaning < 1.12
  assert np.abs(trace[ROW["accel_x"]][inner] - along[inner]).max() < 0.12
  assert np.corrcoef(trace[ROW["accel_y"]][inner], across[inner])[0, 1] > 0.995


def test_power_and_turning_move_the_load():
  simulation, _ = go([CAR, CAR], lambda _t: (np.array([3.0, 1.5]), np.array([0.0, 0.15])), 0.3, speed=1.0)
  state = simulation.state
  assert state.pitch[0] < -1e-3  # nose up under power
  assert state.roll[1] > 1e-3  # the left side up in a turn to the left


def test_a_finer_tolerance_changes_little():
  command = lambda t: (2.2 if t < 0.4 else -0.5, 0.2 * np.sin(9.0 * t))
  usual, _ = go([CAR], command, 0.8, speed=0.8)
  fine, _ = go([CAR], command, 0.8, speed=0.8, tolerance=1e-6)
  gap = np.abs(usual.trace - fine.trace)[:, :, 0].max(axis=0)
  limits = {"x": 2e-4, "y": 2e-4, "yaw": 5e-4, "vx": 2e-3, "vy": 2e-3, "yaw_rate": 0.02, "motor": 1.0, "road": 5e-4}
  for name, limit in limits.items():
    assert gap[ROW[name]] < limit, name
  assert fine.evaluations > 1.3 * usual.evaluations


def test_rubber_is_linear_then_slides():
  """Stiffness over load at small slip, g(v) while sliding, and the spread bristles' closed form between."""
  car = columns(replace(CAR, load_fall=0.0), 1)
  stiffness, length = bristle_stiffness(car), patch(car)
  load, ones, rolling = np.full((4, 1), 6.0), np.ones((4, 1)), np.full((4, 1), 1.5)
  for slip in (1e-3, 0.08, 0.6):
    slide = np.zeros((2, 4, 1))
    slide[1] = slip * rolling
    bristle = np.zeros((2, 4, 1))
    for _ in range(4000):
      force, rate = tyre_forces(car, bristle, slide, rolling, load, stiffness, ones, ones)
      bristle = bristle + 2e-5 * rate
    extra = (1 - CAR.kinetic_share) * np.exp(-np.sqrt(slip * 1.5 / CAR.stribeck_speed))
    peak = CAR.static_friction * (CAR.kinetic_share + extra)
    q = stiffness[1, 0, 0] * length[0] * slip / peak
    expected = peak * (1 - (1 - np.exp(-q)) / q)
    assert -force[1, 0, 0] / 6.0 == pytest.approx(expected, rel=0.01)
  assert expected > 0.8 * peak
  assert stiffness[1, 0, 0] * length[0] / 2 == pytest.approx(CAR.cornering_front)


def test_loads_at_rest_carry_the_car():
  car = columns(SecondCar(cg_lateral=0.01), 1)
  load = rest_loads(car)[:, 0]
  assert load.sum() == pytest.approx(CAR.mass * GRAVITY)
  assert (load[0] + load[2]) / load.sum() == pytest.approx(0.5 + 0.01 / CAR.track_width)


def test_a_state_that_is_not_there_is_said():
  with pytest.raises(AttributeError, match="no state 'heat'"):
    _ = State(np.zeros((len(NAMES), 1))).heat
