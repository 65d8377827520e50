"""Mechanisms of steering and drive do what their equations say, in cases worked out by hand."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.twin.mechanisms.elements import idle_voltage
from tests.qcar_twin.twin.mechanisms.mechanism_bench import CAR, CATALOGUE, PERIOD, act, changed, motion

STEER, VOLT = 1, 0
VOLTS_PER_SPEED = 7.1e-5 / 0.0272  # V s / rad: back-EMF of the bench car


# Steering -----------------------------------------------------------------------------------------


def test_steering_gain_offset_asymmetry_nonlinearity():
  command = [-0.4, 0.0, 0.2]
  np.testing.assert_allclose(act("steering_gain_error", [0.1], command, STEER), [-0.44, 0.0, 0.22])
  np.testing.assert_allclose(act("steering_offset", [0.03], command, STEER), [-0.37, 0.03, 0.23])
  np.testing.assert_allclose(act("steering_asymmetry", [0.1], command, STEER), [-0.36, 0.0, 0.22], atol=2e-4)
  lock = CAR.max_steering
  acting = act("steering_nonlinearity", [0.2, 2.0], [lock, -lock, lock / 2], STEER)
  np.testing.assert_allclose(acting, [0.8 * lock, -0.8 * lock, 0.95 * lock / 2])


def test_steering_lag_starts_from_the_angle_the_wheels_have():
  driven = motion(4, steering_angle=0.2)
  np.testing.assert_allclose(act("steering_lag", [0.05, 0.3], [0.2] * 4, STEER, driven), 0.2, rtol=1e-12)


def test_steering_lag_and_delay_move_a_ramp_by_their_time():
  ramp = np.arange(150) * 0.002
  np.testing.assert_allclose(ramp[-1] - act("steering_delay", [0.043], ramp, STEER)[-1], 0.2 * 0.04, rtol=1e-9)
  assert changed("steering_delay", [0.043]) == {"steering_hold": pytest.approx(0.3)}  # of a period, by the servo
  np.testing.assert_allclose(ramp[-1] - act("steering_lag", [0.043, 0.3], ramp, STEER)[-1], 0.2 * 0.043, rtol=1e-3)


def test_steering_backlash_makes_the_classic_loop():
  acting = act("steering_backlash", [0.04], [0.0, 0.1, 0.2, 0.19, 0.17, 0.15, 0.0], STEER)
  np.testing.assert_allclose(acting, [0.0, 0.08, 0.18, 0.18, 0.18, 0.17, 0.02], atol=1e-12)


@pytest.mark.parametrize(("turns_to", "lies_at"), [(0.21, 0.21), (0.19, 0.19), (0.3, 0.22), (0.0, 0.18)])
def test_steering_backlash_begins_where_the_car_turns_to_as_far_as_the_play_goes(turns_to, lies_at):
  driven = motion(3, steering_angle=0.2, velocity_x=1.5, yaw_rate=1.5 * turns_to / CAR.wheelbase)
  np.testing.assert_allclose(act("steering_backlash", [0.04], [0.2] * 3, STEER, driven), lies_at, atol=3e-4)
  stands = motion(3, steering_angle=0.2, velocity_x=0.0, yaw_rate=1.0)
  np.testing.assert_allclose(act("steering_backlash", [0.04], [0.2] * 3, STEER, stands), 0.2)


def test_steering_dead_zone_has_no_memory():
  acting = act("steering_dead_zone", [0.03], [0.02, 0.1, 0.02, -0.1], STEER)
  np.testing.assert_allclose(acting, [0.0, 0.07, 0.0, -0.07], atol=1e-3)


def test_steering_holds_until_the_command_has_left_its_dead_band():
  acting = act("steering_quantisation", [0.02, 40.0], [0.01, 0.015, 0.03, 0.04, 0.0], STEER)
  np.testing.assert_allclose(acting, [0.0, 0.0, 0.03, 0.03, 0.0], atol=2e-4)


def test_a_servo_that_rounds_knows_whole_steps():
  acting = act("steering_resolution", [1.0, 0.06], [0.0, 0.015, 0.045, 0.06, -0.015, 0.315], STEER)
  np.testing.assert_allclose(acting, [0.0, 0.0, 0.06, 0.06, 0.0, 0.3], atol=0.02 * 0.06)
  half = act("steering_resolution", [0.5, 0.06], [0.015, 0.045], STEER)
  np.testing.assert_allclose(half, [0.0075, 0.0525], atol=0.02 * 0.06)


def test_steering_compliance_settles_where_force_and_twist_agree():
  """A steady turn: F_yf = m l_r a_y / L; the angle ends at u - c F_yf."""
  driven = motion(200, accel_y=2.0, yaw_rate=1.3)
  lateral = 2.0 + 1.3**2 * CAR.imu_y
  force = CAR.mass * CAR.cg_to_rear / CAR.wheelbase * lateral
  acting = act("steering_compliance", [0.008], [0.3] * 200, STEER, driven)
  np.testing.assert_allclose(acting[-1], 0.3 - 0.008 * force, rtol=1e-6)


@pytest.mark.parametrize("lag", [1, 2])
@pytest.mark.parametrize("stiffness", [60.0, 180.0, 250.0])
def test_steering_compliance_does_not_oscillate_against_a_tyre(lag, stiffness):
  """Loop closed with a tyre of so many N/rad whose force comes one or two periods late, at the softest linkage."""
  mechanism, softness = CATALOGUE["steering_compliance"], CATALOGUE["steering_compliance"].parameters[0].upper
  theta, driven = np.array([[softness]]), motion(300)
  angles, state = [0.0] * 3, mechanism.initial(theta, driven.context(0))
  for k in range(300):
    force = stiffness * angles[-lag]
    driven.signals[k, :, 7] = force * CAR.wheelbase / (CAR.mass * CAR.cg_to_rear)
    driven.commands[k, :, 1] = 0.2
    angles.append(mechanism.command(theta, driven.context(k), state, driven.commands[k])[0, 1])
  np.testing.assert_allclose(angles[-20:], 0.2 / (1.0 + softness * stiffness), rtol=1e-3)


# Drive --------------------------------------------------------------------------------------------


def test_drive_dead_zone_lag_and_delay():
  np.testing.assert_allclose(act("drive_dead_zone", [0.2], [0.1, 1.0, -1.0], VOLT), [0.0, 0.8, -0.8], atol=0.011)
  ramp = np.arange(200) * 0.01
  np.testing.assert_allclose(ramp[-1] - act("drive_lag", [0.1, 0.1], ramp, VOLT)[-1], 0.1, rtol=1e-3)
  volts = dataclasses.replace(motion(200), car=dataclasses.replace(CAR, duty_supply=0.0, switches=False))
  np.testing.assert_allclose(ramp[-1] - act("drive_delay", [0.025], ramp, VOLT, volts)[-1], 0.025, rtol=1e-9)
  np.testing.assert_allclose(ramp[-1] - act("drive_delay", [0.025], ramp, VOLT)[-1], 0.02, rtol=1e-9)
  assert changed("drive_delay", [0.025]) == {"drive_hold": pytest.approx(0.5)}  # of a period, by the motor of a duty


def test_throttle_expo_takes_from_small_duties_and_nothing_from_full_ones():
  full = CAR.duty_supply
  np.testing.assert_allclose(act("drive_expo", [0.4], [0.0, full, -full], VOLT), [0.0, full, -full])
  half = 0.5 * full
  np.testing.assert_allclose(act("drive_expo", [0.4], [half, -half], VOLT), [0.7 * half, -0.7 * half])
  np.testing.assert_allclose(act("drive_expo", [1.0], [half], VOLT), full * 0.5**3)


def test_a_delay_of_both_commands_is_that_of_either():
  ramp = np.linspace(0.0, 0.2, 30)
  for column, name in ((VOLT, "drive_delay"), (STEER, "steering_delay")):
    both, one = (act(delay, [0.037], ramp, column) for delay in ("command_delay", name))
    np.testing.assert_array_equal(both, one)


def test_drive_delay_at_rest_waits_and_under_way_carries_on():
  np.testing.assert_allclose(act("drive_delay", [0.03], [1.0] * 4, VOLT)[3], 1.0)
  assert act("drive_delay", [0.03], [1.0] * 4, VOLT)[0] == 0.0
  np.testing.assert_allclose(act("drive_delay", [0.03], [1.0] * 4, VOLT, motion(4, velocity_x=1.0)), 1.0)


def test_frictions_are_forces_at_the_wheels():
  arm = CAR.wheel_radius * CAR.gear_ratio
  assert changed("coulomb_friction", [1.5]) == {"driveline_friction": pytest.approx(1.5 * arm)}
  assert changed("coulomb_friction", [-50.0])["driveline_friction"] == pytest.approx(-8.5e-3)
  at_rest = changed("stiction", [0.7, 0.1])["driveline_friction"]
  crawling = changed("stiction", [0.7, 0.1], motion(motor_speed=0.1 / arm))["driveline_friction"]
  assert at_rest == pytest.approx(0.7 * arm) and crawling == pytest.approx(at_rest / np.e)
  bent = changed("steering_drag", [2.0, 1.0], motion(steering_angle=-0.4))["driveline_friction"]
  assert bent == pytest.approx(2.0 * np.tan(0.4) * arm, rel=0.05)
  assert changed("steering_drag", [2.0, 1.0]) == {}


def test_differential_lock_goes_from_open_to_locked():
  assert changed("differential_lock", [0.5, 0.0]) == {"differential_damping": pytest.approx(0.02)}
  assert changed("differential_lock", [0.98, 0.0])["differential_damping"] > 0.9
  assert changed("differential_lock", [0.0, 0.03]) == {"differential_friction": pytest.approx(0.03)}


def test_quadratic_drag_opposes_the_velocity():
  driven = motion(velocity_x=1.2, velocity_y=-0.9)
  push = CATALOGUE["quadratic_drag"].wrench(np.array([[0.4]]), driven.context(0), {})[0]
  np.testing.assert_allclose(push, [-0.4 * 1.5 * 1.2, 0.4 * 1.5 * 0.9, 0.0])


def test_battery_sag_goes_with_the_power_drawn_and_recovers():
  standing = act("battery_sag", [0.25, 1.0, 0.002], [2.5] * 3, VOLT)
  np.testing.assert_allclose(standing, 2.5 / 1.25, rtol=0.01)
  idle = motion(3, motor_speed=2.5 / VOLTS_PER_SPEED)
  np.testing.assert_allclose(act("battery_sag", [0.25, 1.0, 0.002], [2.5] * 3, VOLT, idle), 2.5)
  slow = act("battery_sag", [0.25, 1.0, 1.0], [2.5] * 100 + [0.0] * 100 + [2.5], VOLT)
  assert slow[0] > 2.48 and slow[99] < 2.5 / 1.15 and slow[99] < slow[200] < 2.5


def test_a_battery_that_is_a_resistance_acts_in_the_motors_circuit():
  resistance = [0.25, 1.0, 0.001]
  assert changed("battery_sag", resistance) == {"supply_sag": pytest.approx(0.25 / 2.5**2)}
  np.testing.assert_array_equal(act("battery_sag", resistance, [2.5] * 3, VOLT), 2.5)
  both = np.array([resistance, [0.25, 1.5, 0.001]])
  assert CATALOGUE["battery_sag"].passes(both).tolist() == [True, False]


def test_battery_discharge_counts_time_and_energy():
  driven = motion(2)
  driven.history[:] = [300.0, 600.0]
  by_time = act("battery_discharge", [0.1, 0.0], [1.0, 1.0], VOLT, driven)
  by_energy = act("battery_discharge", [0.1, 1.0], [1.0, 1.0], VOLT, driven)
  np.testing.assert_allclose([by_time[0], by_energy[0]], np.exp([-0.1, -0.2]), rtol=1e-12)
  assert by_time[1] < by_time[0] and by_energy[1] < by_energy[0]


def test_motor_heating_reaches_its_warmth_and_cools_down():
  commands = np.ones(3000)
  commands[1500:2900] = 0.0
  acting = act("motor_heating", [0.2, 0.0, 5.0], commands, VOLT)
  np.testing.assert_allclose(acting[1499], np.exp(-0.2 * (1 - np.exp(-3.0))), rtol=1e-3)
  assert acting[0] == 1.0 and acting[1499] < acting[2900] < 1.0
  driven = motion(1)
  driven.history[:] = [1e4, 1e4]
  np.testing.assert_allclose(act("motor_heating", [0.2, 0.0, 5.0], [1.0], VOLT, driven), np.exp(-0.2), rtol=1e-6)


def test_motor_heating_leaves_an_idle_motor_alone():
  driven = motion(1, motor_speed=300.0)
  driven.history[:] = [1e4, 1e5]
  idle = 300.0 * VOLTS_PER_SPEED
  np.testing.assert_allclose(act("motor_heating", [0.3, 0.0, 60.0], [idle], VOLT, driven), idle, rtol=1e-12)


def test_weaker_magnets_push_less_from_rest_and_idle_faster():
  """A motor of constant K' = exp(-m) K gives K' (u - K' w): none at w = u / K', where the cold one would brake."""
  warm = [1e4, 1e4]
  standing, spinning = motion(1), motion(1, motor_speed=300.0)
  standing.history[:], spinning.history[:] = warm, warm
  share, back_emf = np.exp(-0.2), 300.0 * VOLTS_PER_SPEED
  np.testing.assert_allclose(act("motor_heating", [0.0, 0.2, 60.0], [2.0], VOLT, standing), 2.0 * share, rtol=1e-6)
  idle = act("motor_heating", [0.0, 0.2, 60.0], [share * back_emf], VOLT, spinning)
  np.testing.assert_allclose(idle, back_emf, rtol=1e-6)  # no torque


def test_coasting_free_takes_the_braking_away_at_zero_only():
  driven = motion(2, motor_speed=400.0)
  acting = act("coast_freewheel", [1.0, 0.1], [0.0, 2.0], VOLT, driven)
  np.testing.assert_allclose(acting, [400.0 * VOLTS_PER_SPEED, 2.0], atol=1e-4)


def test_drive_asymmetry_acts_on_negative_torque_or_voltage():
  driven = motion(3, motor_speed=400.0)
  idle = 400.0 * VOLTS_PER_SPEED
  by_torque = act("drive_asymmetry", [0.2, 0.0], [3.0, 0.0, -1.0], VOLT, driven)
  np.testing.assert_allclose(by_torque, [3.0, -0.2 * idle, -1.0 - 0.2 * (1.0 + idle)], atol=0.005)
  by_voltage = act("drive_asymmetry", [0.2, 1.0], [3.0, 0.0, -1.0], VOLT, driven)
  np.testing.assert_allclose(by_voltage, [3.0, 0.0, -1.2], atol=0.005)


def test_backlash_costs_time_not_momentum():
  """After a change of sign the voltage comes late, and all of it comes; the next period is as commanded."""
  commands = np.array([1.0] * 5 + [-1.0] * 15)
  acting = act("driveline_backlash", [1.0, 2e-6], commands, VOLT)
  np.testing.assert_array_equal(acting[:5], 1.0)
  assert acting[5] > -0.9 and acting[6] < -1.05
  np.testing.assert_allclose(acting.sum(), commands.sum(), rtol=1e-12)
  np.testing.assert_allclose(acting[-5:], -1.0)


def test_backlash_takes_as_long_as_free_flight_across_the_play():
  """Torque k u on J over b rad: t = sqrt(2 b J / (k u)), here over several periods."""
  play, inertia, volts = 3.0, 5e-5, 0.5
  free = np.sqrt(2 * play * inertia / (0.0272 * volts))
  commands = np.array([volts] * 2 + [-volts] * 60)
  acting = act("driveline_backlash", [play, inertia], commands, VOLT)
  late = np.cumsum(acting - commands)  # V periods still owed
  assert free / PERIOD - 1.0 <= int(np.argmin(acting)) - 2 <= free / PERIOD + 1.0
  np.testing.assert_allclose(late[-1], 0.0, atol=1e-9)


def test_cogging_is_a_ripple_of_the_wheel_angle():
  speed = 2 * np.pi / CAR.gear_ratio  # one turn of the wheels a second
  acting = act("cogging", [0.1, 0.0, 2.0], [1.0] * 100, VOLT, motion(100, motor_speed=speed)) - 1.0
  middle = (np.arange(100) + 0.5) * PERIOD
  np.testing.assert_allclose(acting, 0.1 * np.sin(4 * np.pi * middle), atol=1e-4)
  fast = act("cogging", [0.1, 0.0, 2.0], [1.0] * 9, VOLT, motion(9, motor_speed=50 * speed)) - 1.0
  np.testing.assert_allclose(fast, 0.0, atol=1e-12)  # a whole ripple per period averages out


@pytest.mark.parametrize("speed, command, limits, left", [
  (0.0, 3.0, (0.5, 0.0), 2.0),  # driving from rest: 2 m/s^2 of 3
  (30.0, -3.0, (0.5, 0.0), -3.0),  # braking is not limited by the limit of driving
  (30.0, -3.0, (0.0, 1.0), -1.0),
  (-30.0, -3.0, (0.5, 0.0), -2.0),  # driving backwards
  (30.0, 1.5, (0.5, 0.25), 1.5),  # below both
])  # fmt: skip
def test_a_limited_current_gives_no_more_than_its_force(speed, command, limits, left):
  """Commands as accelerations of the car: of 3 m/s^2 asked for a limit of 1 / l is left."""
  context = motion(motor_speed=speed).context(0)
  back = float(idle_voltage(context)[0])
  per_acceleration = CAR.mass * CAR.wheel_radius * CAR.gear_ratio / float(context.torque_per_volt[0])
  given = np.array([[back + per_acceleration * command, 0.1]])
  acting = CATALOGUE["drive_limit"].command(np.array([limits]), context, {}, given)
  assert acting[0, 1] == 0.1
  assert acting[0, 0] - back == pytest.approx(per_acceleration * left, abs=0.02)  # the rounded corner
