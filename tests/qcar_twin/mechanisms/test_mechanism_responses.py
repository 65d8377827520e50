"""Each mechanism does what its equation says, in a case worked out by hand."""

import numpy as np
import pytest
from mechanism_bench import CAR, PERIOD, BenchModel, drive, still

from qcar_twin.mechanisms import catalogue
from qcar_twin.plant import SIGNALS

NAMES = catalogue()
STEER, VOLT = 1, 0
VOLTS_PER_SPEED = 7.1e-5 / 0.0272  # V s / rad: back-EMF of the bench car


def motion(steps=1, n=1, **signals):
  """A drive with constant or (T,)-shaped signals by name; everything else zero."""
  out = still(n=n, steps=steps)
  for name, value in signals.items():
    out.signals[..., SIGNALS.index(name)] = np.asarray(value, float).reshape(-1, 1)
  return out


def act(name, theta, commands, column, driven=None):
  """What a command (T,) becomes, (T,)."""
  commands = np.asarray(commands, float)
  driven = driven or motion(len(commands))
  driven.commands[..., column] = commands[:, None]
  mechanism, theta = NAMES[name], np.array([theta], float)
  state = mechanism.initial(theta, driven.context(0))
  out = []
  for k in range(len(commands)):
    out.append(mechanism.command(theta, driven.context(k), state, driven.commands[k].copy())[0])
  other = 1 - column
  np.testing.assert_array_equal(np.array(out)[:, other], driven.commands[:, 0, other])
  return np.array(out)[:, column]


def changed(name, theta, driven=None, k=0):
  """Quantities after `write_model` over those before, as differences."""
  driven, mechanism = driven or motion(), NAMES[name]
  before, model = BenchModel(1), BenchModel(1)
  mechanism.write_model(np.array([theta], float), driven.context(k), model)
  return {q: (v - before.values[q])[0] for q, v in model.values.items() if np.any(v != before.values[q])}


def shown(name, theta, track):
  out = NAMES[name].measure(np.array([theta], float), track)
  same = {s: np.array_equal(out[..., i], track.signals[..., i]) for i, s in enumerate(SIGNALS)}
  return {s: out[0, :, SIGNALS.index(s)] for s, kept in same.items() if not kept}


# Steering -----------------------------------------------------------------------------------------


def test_steering_gain_offset_asymmetry_nonlinearity():
  command = [-0.4, 0.0, 0.2]
  np.testing.assert_allclose(act("steering_gain_error", [0.1], command, STEER), [-0.44, 0.0, 0.22])
  np.testing.assert_allclose(act("steering_offset", [0.03], command, STEER), [-0.37, 0.03, 0.23])
  np.testing.assert_allclose(act("steering_asymmetry", [0.1], command, STEER), [-0.36, 0.0, 0.22], atol=2e-4)
  lock = CAR.max_steering
  found = act("steering_nonlinearity", [0.2, 2.0], [lock, -lock, lock / 2], STEER)
  np.testing.assert_allclose(found, [0.8 * lock, -0.8 * lock, 0.95 * lock / 2])


def test_steering_lag_starts_from_the_angle_the_wheels_have():
  driven = motion(4, steering_angle=0.2)
  np.testing.assert_allclose(act("steering_lag", [0.05, 0.3], [0.2] * 4, STEER, driven), 0.2, rtol=1e-12)


def test_steering_lag_and_delay_move_a_ramp_by_their_time():
  ramp = np.arange(150) * 0.002
  np.testing.assert_allclose(ramp[-1] - act("steering_delay", [0.043], ramp, STEER)[-1], 0.2 * 0.043, rtol=1e-9)
  np.testing.assert_allclose(ramp[-1] - act("steering_lag", [0.043, 0.3], ramp, STEER)[-1], 0.2 * 0.043, rtol=1e-3)


def test_steering_rate_limit_runs_at_its_rate_and_arrives():
  found = act("steering_rate_limit", [0.25], [0.1] * 5, STEER)  # 4 rad/s: 0.04 rad a period
  np.testing.assert_allclose(found, [0.02, 0.06, 0.095, 0.1, 0.1], atol=1e-12)


def test_slow_steering_never_meets_its_rate_limit():
  slow = np.arange(50) * 0.01  # 1 rad/s
  np.testing.assert_allclose(act("steering_rate_limit", [0.2], slow, STEER), slow, atol=0.0011)


def test_steering_backlash_makes_the_classic_loop():
  found = act("steering_backlash", [0.04], [0.0, 0.1, 0.2, 0.19, 0.17, 0.15, 0.0], STEER)
  np.testing.assert_allclose(found, [0.0, 0.08, 0.18, 0.18, 0.18, 0.17, 0.02], atol=1e-12)


def test_steering_dead_zone_has_no_memory():
  found = act("steering_dead_zone", [0.03], [0.02, 0.1, 0.02, -0.1], STEER)
  np.testing.assert_allclose(found, [0.0, 0.07, 0.0, -0.07], atol=1e-3)


def test_steering_holds_until_the_command_has_left_its_dead_band():
  found = act("steering_quantisation", [0.02, 40.0], [0.01, 0.015, 0.03, 0.04, 0.0], STEER)
  np.testing.assert_allclose(found, [0.0, 0.0, 0.03, 0.03, 0.0], atol=2e-4)


def test_steering_compliance_settles_where_force_and_twist_agree():
  """A steady turn: F_yf = m l_r a_y / L; the angle ends at u - c F_yf."""
  driven = motion(200, accel_y=2.0, yaw_rate=1.3)
  lateral = 2.0 + 1.3**2 * CAR.imu_y
  force = CAR.mass * CAR.cg_to_rear / CAR.wheelbase * lateral
  found = act("steering_compliance", [0.008], [0.3] * 200, STEER, driven)
  np.testing.assert_allclose(found[-1], 0.3 - 0.008 * force, rtol=1e-6)


@pytest.mark.parametrize("lag", [1, 2])
@pytest.mark.parametrize("stiffness", [60.0, 180.0, 250.0])
def test_steering_compliance_does_not_oscillate_against_a_tyre(lag, stiffness):
  """Loop closed with a tyre of so many N/rad whose force comes one or two periods late, at the softest linkage."""
  mechanism, softness = NAMES["steering_compliance"], NAMES["steering_compliance"].parameters[0].upper
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
  np.testing.assert_allclose(ramp[-1] - act("drive_delay", [0.025], ramp, VOLT)[-1], 0.025, rtol=1e-9)


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
  push = NAMES["quadratic_drag"].wrench(np.array([[0.4]]), driven.context(0), {})[0]
  np.testing.assert_allclose(push, [-0.4 * 1.5 * 1.2, 0.4 * 1.5 * 0.9, 0.0])


def test_battery_sag_goes_with_the_power_drawn_and_recovers():
  standing = act("battery_sag", [0.25, 1.0, 0.001], [2.5] * 3, VOLT)
  np.testing.assert_allclose(standing, 2.5 / 1.25, rtol=0.01)
  idle = motion(3, motor_speed=2.5 / VOLTS_PER_SPEED)
  np.testing.assert_allclose(act("battery_sag", [0.25, 1.0, 0.001], [2.5] * 3, VOLT, idle), 2.5)
  slow = act("battery_sag", [0.25, 1.0, 1.0], [2.5] * 100 + [0.0] * 100 + [2.5], VOLT)
  assert slow[0] > 2.48 and slow[99] < 2.5 / 1.15 and slow[99] < slow[200] < 2.5


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
  found = act("motor_heating", [0.2, 0.0, 5.0], commands, VOLT)
  np.testing.assert_allclose(found[1499], np.exp(-0.2 * (1 - np.exp(-3.0))), rtol=1e-3)
  assert found[0] == 1.0 and found[1499] < found[2900] < 1.0
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
  found = act("coast_freewheel", [1.0, 0.1], [0.0, 2.0], VOLT, driven)
  np.testing.assert_allclose(found, [400.0 * VOLTS_PER_SPEED, 2.0], atol=1e-4)


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
  found = act("driveline_backlash", [1.0, 2e-6], commands, VOLT)
  np.testing.assert_array_equal(found[:5], 1.0)
  assert found[5] > -0.9 and found[6] < -1.05
  np.testing.assert_allclose(found.sum(), commands.sum(), rtol=1e-12)
  np.testing.assert_allclose(found[-5:], -1.0)


def test_backlash_takes_as_long_as_free_flight_across_the_play():
  """Torque k u on J over b rad: t = sqrt(2 b J / (k u)), here over several periods."""
  play, inertia, volts = 3.0, 5e-5, 0.5
  free = np.sqrt(2 * play * inertia / (0.0272 * volts))
  commands = np.array([volts] * 2 + [-volts] * 60)
  found = act("driveline_backlash", [play, inertia], commands, VOLT)
  late = np.cumsum(found - commands)  # V periods still owed
  assert free / PERIOD - 1.0 <= int(np.argmin(found)) - 2 <= free / PERIOD + 1.0
  np.testing.assert_allclose(late[-1], 0.0, atol=1e-9)


def test_cogging_is_a_ripple_of_the_wheel_angle():
  speed = 2 * np.pi / CAR.gear_ratio  # one turn of the wheels a second
  found = act("cogging", [0.1, 0.0, 2.0], [1.0] * 100, VOLT, motion(100, motor_speed=speed)) - 1.0
  middle = (np.arange(100) + 0.5) * PERIOD
  np.testing.assert_allclose(found, 0.1 * np.sin(4 * np.pi * middle), atol=1e-4)
  fast = act("cogging", [0.1, 0.0, 2.0], [1.0] * 9, VOLT, motion(9, motor_speed=50 * speed)) - 1.0
  np.testing.assert_allclose(fast, 0.0, atol=1e-12)  # a whole ripple per period averages out


# Tyres, ground, body ------------------------------------------------------------------------------


def test_model_quantities_change_as_stated():
  np.testing.assert_allclose(changed("tyre_relaxation", [0.05])["relaxation_length"], 0.05)
  saturated = changed("tyre_saturation", [0.25, -0.3])
  np.testing.assert_allclose(saturated["friction_coefficient"], -0.2)
  np.testing.assert_allclose(saturated["tyre_shape"], -0.3)
  moved = changed("load_transfer", [0.02, 0.3])
  assert moved["cg_height_offset"] == pytest.approx(0.02)
  np.testing.assert_allclose(moved["load_exponent"], 0.3)
  assert changed("floor_slope", [0.2, -0.1]) == {"gravity_x": 0.2, "gravity_y": -0.1}
  assert changed("cg_lateral_offset", [0.01]) == {"cg_lateral_offset": 0.01}
  assert changed("payload", [0.5, 0.06]) == {"added_mass": 0.5, "added_mass_x": pytest.approx(0.06)}


def test_two_payloads_add_with_their_common_centre():
  model, payload = BenchModel(1), NAMES["payload"]
  payload.write_model(np.array([[0.4, 0.1]]), motion().context(0), model)
  payload.write_model(np.array([[0.4, -0.05]]), motion().context(0), model)
  assert model.values["added_mass"][0] == pytest.approx(0.8)
  assert model.values["added_mass_x"][0] == pytest.approx(0.025)


def test_longitudinal_slip_adds_its_share_at_its_drive():
  before = BenchModel(1).values["longitudinal_stiffness"][0]
  after = before + changed("longitudinal_slip", [0.04])["longitudinal_stiffness"]
  force = CAR.mass * 2.0 / 4.0
  np.testing.assert_allclose(force / after - force / before, 0.04)


def test_combined_slip_takes_side_stiffness_under_drive_or_brake():
  arm, driven = CAR.wheel_radius * CAR.gear_ratio, motion()
  driven.commands[..., 0] = 2.0 * CAR.mass * arm / 0.0272  # 2 m/s^2 from a standing motor
  relative = changed("combined_slip", [0.25], driven)["cornering_stiffness"] / 90.0
  np.testing.assert_allclose(1.0 + relative, 1.0 / 1.25)
  assert changed("combined_slip", [0.25]) == {}


@pytest.mark.parametrize("suddenness, early, late", [(1.0, 1 - np.exp(-0.5), 1 - np.exp(-1.5)), (20.0, 0.0, 1.0)])
def test_friction_change_creeps_or_drops(suddenness, early, late):
  for seconds, share in ((30.0, early), (90.0, late)):
    driven = motion()
    driven.history[:, 0] = seconds
    found = changed("friction_change", [-0.25, 60.0, suddenness, 0.0], driven)
    np.testing.assert_allclose(found.get("friction_coefficient", 0.0), -0.25 * 0.8 * share, atol=1e-6)
    assert "cornering_stiffness" not in found


def test_friction_patch_is_felt_by_the_wheels_that_stand_on_it():
  """Facing +y at the origin: the left wheels are at -x. A patch to the left takes their grip only."""
  driven = motion(pose_yaw=np.pi / 2)
  found = changed("friction_patch", [0.5, -0.6, 0.0, 0.55, 0.0], driven)["friction_coefficient"]
  left, right = found[[0, 2]], found[[1, 3]]
  assert np.all(left < -0.2) and np.all(right > -0.05)
  assert changed("friction_patch", [0.5, 30.0, 0.0, 0.5, 0.0], driven) == {}


def test_side_force_pushes_left_at_its_point_and_not_at_rest():
  push = NAMES["side_force"].wrench(np.array([[0.7, 0.1]]), motion(velocity_x=-2.0).context(0), {})[0]
  np.testing.assert_allclose(push, [0.0, 0.7, 0.07], rtol=1e-3)
  assert not np.any(NAMES["side_force"].wrench(np.array([[0.7, 0.1]]), motion().context(0), {}))


# Sensors ------------------------------------------------------------------------------------------


def test_scales_and_biases():
  track = drive(n=1, steps=50, seed=4).track()
  gyro, ahead, left = (track.signal(s)[0] for s in ("yaw_rate", "accel_x", "accel_y"))
  np.testing.assert_allclose(shown("gyro_scale", [0.05], track)["yaw_rate"], 1.05 * gyro)
  drifting = shown("gyro_bias", [0.02, 0.06], track)["yaw_rate"] - gyro
  np.testing.assert_allclose(drifting, 0.02 + 0.001 * track.recording_time[0], atol=1e-12)
  biased = shown("accel_bias", [0.1, -0.2, 0.0, 0.0], track)
  np.testing.assert_allclose(biased["accel_x"] - ahead, 0.1)
  np.testing.assert_allclose(biased["accel_y"] - left, -0.2)
  scaled = shown("accel_bias", [0.0, 0.0, 0.02, -0.03], track)
  np.testing.assert_allclose(scaled["accel_x"], 1.02 * ahead)
  np.testing.assert_allclose(scaled["accel_y"], 0.97 * left)
  smaller = shown("wheel_radius_error", [-0.2], track)["motor_speed"]
  np.testing.assert_allclose(smaller, 1.25 * track.signal("motor_speed")[0])


def test_imu_turned_left_feels_forward_acceleration_as_rightward():
  track = motion(3, accel_x=2.0).track()
  found = shown("imu_misalignment", [0.1], track)
  np.testing.assert_allclose(found["accel_x"], 2.0 * np.cos(0.1))
  np.testing.assert_allclose(found["accel_y"], -2.0 * np.sin(0.1))


def test_imu_lever_arm_feels_centripetal_and_tangential_acceleration():
  rate = 0.5 + 3.0 * PERIOD * np.arange(20)  # 3 rad/s^2
  found = shown("imu_lever_arm", [0.05, 0.02], motion(20, yaw_rate=rate).track())
  np.testing.assert_allclose(found["accel_x"], -(rate**2) * 0.05 - 3.0 * 0.02, atol=1e-9)
  np.testing.assert_allclose(found["accel_y"], 3.0 * 0.05 - rate**2 * 0.02, atol=1e-9)


def test_latencies_shift_their_own_sensors_only():
  ramp = np.arange(40) * PERIOD
  track = motion(40, pose_x=ramp, pose_yaw=-ramp, yaw_rate=ramp, accel_x=ramp, motor_speed=ramp).track()
  imu, pose = shown("imu_latency", [0.034], track), shown("pose_latency", [0.034], track)
  encoder = shown("encoder_latency", [0.034], track)
  assert set(imu) == {"yaw_rate", "accel_x"} and set(pose) == {"pose_x", "pose_yaw"} and set(encoder) == {"motor_speed"}
  np.testing.assert_allclose(encoder["motor_speed"], np.maximum(ramp - 0.034, 0.0), atol=1e-12)
  np.testing.assert_allclose(imu["yaw_rate"], np.maximum(ramp - 0.034, 0.0), atol=1e-12)
  np.testing.assert_allclose(pose["pose_x"], ramp - 0.034, atol=1e-12)


def test_clock_drift_grows_with_the_time_of_the_recording():
  ramp = np.arange(40) * PERIOD
  driven = motion(40, pose_x=ramp, motor_speed=ramp)
  driven.offset[:] = 10.0
  found = shown("clock_drift", [0.005, 0.5], driven.track())
  late = 0.005 * (10.0 + ramp)
  np.testing.assert_allclose(found["pose_x"], ramp - late, atol=1e-12)
  np.testing.assert_allclose(found["motor_speed"], np.maximum(ramp - late / 2, 0.0), atol=1e-12)


def test_pose_mount_turns_and_shifts_the_tracked_point():
  track = motion(2, pose_x=1.0, pose_yaw=np.pi / 2).track()
  found = shown("pose_mount", [0.04, 0.1, 0.02], track)
  np.testing.assert_allclose(found["pose_x"], 1.0 - 0.02, atol=1e-12)
  np.testing.assert_allclose(found["pose_y"], 0.1, atol=1e-12)
  np.testing.assert_allclose(found["pose_yaw"], np.pi / 2 + 0.04)
