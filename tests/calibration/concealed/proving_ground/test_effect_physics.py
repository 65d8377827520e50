"""What single effects of tyre, drive and body do, against what their docstrings say."""

import numpy as np
import pytest

from calibration.concealed.proving_ground.car import GRAVITY, fleet, one_of
from calibration.concealed.proving_ground.simulation import Carried, Simulation
from tests.calibration.concealed.proving_ground.effect_bench import FREE, PLAIN, changed, effect, go, simulation


def test_wheel_radius_and_relaxation_change_the_cars_numbers():
  assert changed("wheel_radius_error", -1.0).wheel_radius == pytest.approx(0.96 * PLAIN.wheel_radius)
  softer = changed("tyre_relaxation")
  assert (softer.relaxation_front, softer.relaxation) == (pytest.approx(0.07), PLAIN.relaxation)


def test_longitudinal_slip_adds_its_share_at_two_metres_per_second_squared():
  """Slip at a steady pull of m 2 m/s^2, over all wheels."""
  slips = []
  for car in (FREE, changed("longitudinal_slip", car=FREE)):
    sim = simulation(car=car, start=(0, 0, 0, 1.5, 0, 0, 0))
    sim.dynamics.noise_wrench[0] = -2.0 * car.mass
    for _ in range(150):
      held = car.motor_constant * sim.dynamics.state.motor[0]
      need = 2.0 * car.mass * car.wheel_radius * car.gear_ratio * car.motor_resistance / car.motor_constant
      sim.advance(np.array([[held + need], [0.0]]))
    s = sim.dynamics.state
    slips.append(s.wheel.mean() * car.wheel_radius / s.vx[0] - 1)
  assert slips[1] - slips[0] == pytest.approx(
    0.04, rel=0.2
  )  # the tyre bends, and its slip is over the larger of two speeds


def test_tyre_saturation_takes_its_share_of_the_peak_and_little_before():
  ends = []
  for hidden in ((), (effect("tyre_saturation"),)):
    sim = go(simulation(*hidden, start=(0, 0, 0, 2.0, 0, 0, 0)), 2.5, 0.5, 0.3)
    slow = go(simulation(*hidden, start=(0, 0, 0, 1.0, 0, 0, 0)), 1.0, 0.03, 0.5)
    ends.append((np.hypot(*sim.dynamics.force[:, 1]).max(), slow.dynamics.state.yaw_rate[0]))
  assert ends[1][0] < 0.9 * ends[0][0]
  assert ends[1][1] == pytest.approx(ends[0][1], rel=0.01)


@pytest.mark.slow
def test_combined_slip_takes_side_force_under_power_only():
  turns = []
  for hidden in ((), (effect("combined_slip", 2.0),)):
    coasting = simulation(*hidden, car=FREE, start=(0, 0, 0, 1.2, 0, 0, 0))
    coasting.dynamics.car.motor_resistance[:] = 1e6
    turns.append(
      (
        go(simulation(*hidden), 3.0, 0.15, 0.8).dynamics.state.yaw_rate[0],
        go(coasting, 0.0, 0.15, 0.6).dynamics.state.yaw_rate[0],
      )
    )
  assert abs(turns[1][0] / turns[0][0] - 1) > 0.01
  assert turns[1][1] == pytest.approx(turns[0][1], rel=5e-3)


def test_load_transfer_raises_the_centre_of_gravity_and_the_loads_it_moves():
  high = changed("load_transfer")
  assert high.cg_height == pytest.approx(PLAIN.cg_height + 0.025)
  moved = []
  for car in (PLAIN, high):
    load = go(simulation(car=car, start=(0, 0, 0, 1.5, 0, 0, 0)), 1.6, 0.2, 1.0).dynamics.load
    moved.append((load[1] + load[3] - load[0] - load[2])[0])
  assert moved[1] / moved[0] == pytest.approx(high.cg_height / PLAIN.cg_height, rel=0.05)


def test_friction_change_comes_half_way_through_the_session():
  n = 3
  sim = Simulation(fleet([PLAIN], [n]), (effect("friction_change", 1.0, slice(0, n)),))
  nothing, length = np.zeros(n), np.full(n, 600.0)
  sim.begin(np.zeros((n, 7)), carried=Carried(nothing, nothing, np.array([0.0, 300.0, 590.0]), length, length, length))
  sim.advance(np.zeros((2, n)))
  assert sim.dynamics.grip[0] == pytest.approx([1.0, 0.875, 0.75], abs=1e-3)


def test_side_force_pushes_a_rolling_car_and_not_a_standing_one():
  push = effect("side_force", -1.0)
  rolling, standing = (simulation(push, start=(0, 0, 0, v, 0, 0, 0)) for v in (1.0, 0.0))
  for sim in (rolling, standing):
    sim.dynamics.derivative()
  assert rolling.dynamics.wrench[1, 0] == pytest.approx(-0.7, rel=0.01)
  assert rolling.dynamics.wrench[2, 0] == pytest.approx(-0.7 * push.truth()["side_force_x"], rel=0.01)
  assert standing.dynamics.wrench[1, 0] == 0.0


def test_a_braked_wheel_turns_the_car_to_its_side():
  ways = [go(simulation(effect("wheel_drag", s), start=(0, 0, 0, 1.0, 0, 0, 0)), 1.0, 0.0, 0.5) for s in (1.0, -1.0)]
  left, right = (sim.dynamics.state.yaw_rate[0] for sim in ways)
  assert left - right > 0.02 and left > 0.005 and right < -0.005


@pytest.mark.slow
def test_battery_sag_takes_its_share_at_stall():
  sim = simulation(effect("battery_sag"))
  sim.dynamics.car.mass[:] = 1e4  # it does not move away in the time
  sim.dynamics.car.motor_inertia[:] = 10.0
  sim.dynamics.__init__(sim.car)
  sim.begin(np.zeros((1, 7)))
  go(sim, 2.5, 0.0, 5.0)
  left = sim.dynamics.voltage[0] / 2.5
  expected = (np.sqrt(1 + 4 * 0.3) - 1) / (2 * 0.3)  # x (1 + 0.3 x) = 1: duty times a current that goes with x
  assert left == pytest.approx(expected, rel=0.01)


def test_the_drive_lag_has_the_sum_of_its_time_constants():
  sim = simulation(effect("drive_lag"))
  lag = 0.0
  for _ in range(100):
    sim.advance(np.array([[1.0], [0.0]]))
    lag += 0.01 * (1 - sim.dynamics.voltage[0])
  assert lag == pytest.approx(0.10, abs=0.006)


def test_heating_weakens_the_motor_and_cold_ones_are_whole():
  hot = effect("motor_heating", 1.0, slice(0, 2))
  sim = Simulation(fleet([PLAIN], [2]), (hot,))
  nothing, one = np.zeros(2), np.ones(2)
  sim.begin(np.zeros((2, 7)), carried=Carried(nothing, nothing, np.array([0.0, 5000.0]), 600 * one, 100 * one, one))
  sim.advance(np.zeros((2, 2)))
  assert sim.dynamics.constant / PLAIN.motor_constant == pytest.approx([1.0, 1 / 1.15], abs=1e-3)


def test_cogging_ripples_as_often_as_it_says():
  gear = effect("cogging")
  sim = go(simulation(gear), 1.2, 0.0, 1.5)
  turns, torque = [], []
  for _ in range(200):
    sim.advance(np.array([[1.2], [0.0]]))
    turns.append(sim.dynamics.state.motor_angle[0] * PLAIN.gear_ratio / (2 * np.pi))
    torque.append(sim.dynamics.motor_torque[0])
  cycles = np.sum(np.diff(np.sign(torque)) > 0) / (turns[-1] - turns[0])
  assert cycles == pytest.approx(gear.truth()["cogging_order"], rel=0.08)


def test_driveline_play_is_counted_at_the_motor():
  assert 2 * changed("driveline_backlash").shaft_play / PLAIN.gear_ratio == pytest.approx(1.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_lateral_offset_turns_the_car_under_power(side):
  sim = go(simulation(effect("cg_lateral_offset", side)), 2.5, 0.0, 0.15)
  assert np.sign(sim.dynamics.state.yaw_rate[0]) == side
  car = changed("cg_lateral_offset", side)
  assert car.imu_y == pytest.approx(PLAIN.imu_y - side * 0.014)


def test_a_payload_keeps_the_axles_and_the_instruments_where_they_are():
  box = effect("payload")
  columns = fleet([PLAIN], [1])
  box.prepare(columns)
  car, truth = one_of(columns, 0), box.truth()
  assert car.wheelbase == pytest.approx(PLAIN.wheelbase)
  assert car.mass == pytest.approx(PLAIN.mass + truth["payload_mass"])
  shift = truth["payload_x"] * truth["payload_mass"] / car.mass
  assert car.cg_to_front == pytest.approx(PLAIN.cg_to_front - shift)
  assert car.imu_x == pytest.approx(PLAIN.imu_x - shift)
  assert car.marker_x == pytest.approx(-shift)
  assert car.yaw_inertia > PLAIN.yaw_inertia


def test_a_locked_differential_resists_turning_up_to_its_preload():
  sim = simulation(effect("differential_lock"), start=(0, 0, 0, 0.4, 0, 0, 0))
  go(sim, 0.6, 0.35, 1.0)
  torque = sim.dynamics.wheel_torque[:, 0]
  assert torque[[0, 2]] == pytest.approx(-torque[[1, 3]])
  assert torque[0] > 0 > torque[1]  # it drives the inner, slower wheel
  assert torque[0] - torque[1] == pytest.approx(0.04, rel=0.15)


def test_dry_friction_and_film_drag_have_the_forces_they_state():
  for name, speed, force in (("coulomb_friction", 1.5, 1.0), ("quadratic_drag", 1.5, 0.4 * 1.5**2)):
    sim = simulation(effect(name), start=(0, 0, 0, speed, 0, 0, 0))
    sim.dynamics.derivative()
    wheels = sim.dynamics.wheel_torque.sum() / PLAIN.wheel_radius
    assert -(sim.dynamics.wrench[0, 0] + wheels) == pytest.approx(force, rel=0.01)


@pytest.mark.slow
def test_stiction_raises_the_breakaway_voltage():
  """Below the voltage that overcomes friction and stiction together the car stays."""
  lever = PLAIN.gear_ratio * PLAIN.wheel_radius
  kinetic = PLAIN.motor_coulomb + lever * PLAIN.rolling_resistance * PLAIN.mass * GRAVITY
  volts = (kinetic + 0.5 * lever * 0.7) * PLAIN.motor_resistance / PLAIN.motor_constant
  free, stuck = (go(simulation(*e), volts, 0.0, 1.5).dynamics.state.vx[0] for e in ((), (effect("stiction"),)))
  assert free > 0.02
  assert abs(stuck) < 2e-3
