"""Mechanisms of tyres, ground, body and sensors do what their equations say, in cases worked out by hand."""

import numpy as np
import pytest

from qcar_twin.plant import Driving
from tests.qcar_twin.twin.mechanisms.mechanism_bench import (
  CAR,
  CATALOGUE,
  PERIOD,
  BenchModel,
  changed,
  drive,
  motion,
  shown,
)

# Tyres, ground, body ------------------------------------------------------------------------------


def test_model_quantities_change_as_stated():
  softer = changed("tyre_relaxation", [0.05])["relaxation_length"]
  np.testing.assert_allclose(softer, [0.05, 0.05, 0.0, 0.0])
  harder = changed("tyre_relaxation", [-0.05])["relaxation_length"]
  np.testing.assert_allclose(harder, [-0.01, -0.01, 0.0, 0.0])  # no length is negative
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
  model, payload = BenchModel(1), CATALOGUE["payload"]
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
    changes = changed("friction_change", [-0.25, 60.0, suddenness, 0.0], driven)
    np.testing.assert_allclose(changes.get("friction_coefficient", 0.0), -0.25 * 0.8 * share, atol=1e-6)
    assert "cornering_stiffness" not in changes


@pytest.mark.parametrize("suddenness, early, late", [(1.0, 1 - np.exp(-0.5), 1 - np.exp(-1.5)), (20.0, 0.0, 1.0)])
def test_a_resistance_that_changes_creeps_in_or_comes_at_once(suddenness, early, late):
  """0.6 N at the wheels by equal power; taken off, friction stops at nothing."""
  for seconds, share in ((30.0, early), (90.0, late)):
    driven = motion()
    driven.history[:, 0] = seconds
    more = changed("resistance_change", [0.6, 60.0, suddenness], driven).get("driveline_friction", 0.0)
    np.testing.assert_allclose(more, 0.6 * share * CAR.wheel_radius * CAR.gear_ratio, rtol=0.02, atol=1e-8)
    driven = motion()
    driven.history[:, 0] = seconds
    bench = BenchModel(1)
    less = changed("resistance_change", [-2.0, 60.0, suddenness], driven).get("driveline_friction", 0.0)
    assert np.all(bench.values["driveline_friction"] + less >= 0.0)


def test_friction_patch_is_felt_by_the_wheels_that_stand_on_it():
  """Facing +y at the origin: the left wheels are at -x. A patch to the left takes their grip only."""
  driven = motion(pose_yaw=np.pi / 2)
  friction = changed("friction_patch", [0.5, -0.6, 0.0, 0.55, 0.0], driven)["friction_coefficient"]
  left, right = friction[[0, 2]], friction[[1, 3]]
  assert np.all(left < -0.2) and np.all(right > -0.05)
  assert changed("friction_patch", [0.5, 30.0, 0.0, 0.5, 0.0], driven) == {}


def test_side_force_pushes_left_at_its_point_and_not_at_rest():
  push = CATALOGUE["side_force"].wrench(np.array([[0.7, 0.1]]), motion(velocity_x=-2.0).context(0), {})[0]
  np.testing.assert_allclose(push, [0.0, 0.7, 0.07], rtol=1e-3)
  assert not np.any(CATALOGUE["side_force"].wrench(np.array([[0.7, 0.1]]), motion().context(0), {}))


def test_a_braked_wheel_holds_back_its_own_side_and_the_other_way_when_it_rolls_backwards():
  push = lambda size, **moving: CATALOGUE["wheel_drag"].wrench(np.array([[size]]), motion(**moving).context(0), {})[0]
  lever = 0.5 * CAR.track_width
  np.testing.assert_allclose(push(0.8, velocity_x=2.0), [-0.8, 0.0, 0.8 * lever], rtol=1e-3)
  np.testing.assert_allclose(push(-0.8, velocity_x=2.0), [-0.8, 0.0, -0.8 * lever], rtol=1e-3)
  np.testing.assert_allclose(push(0.8, velocity_x=-2.0), [0.8, 0.0, -0.8 * lever], rtol=1e-3)
  assert not push(0.8).any()
  turning_about_it = push(0.8, velocity_x=lever * 2.0, yaw_rate=2.0)  # the left wheel stands
  np.testing.assert_allclose(turning_about_it, 0.0, atol=1e-12)


# Sensors ------------------------------------------------------------------------------------------


def test_scales_and_biases():
  track = drive(n=1, steps=50, seed=4).track()
  gyro, ahead, left = (track.signal(s)[0] for s in ("yaw_rate", "accel_x", "accel_y"))
  np.testing.assert_allclose(shown("gyro_scale", [0.05], track)["yaw_rate"], 1.05 * gyro)
  np.testing.assert_allclose(shown("gyro_bias", [0.02], track)["yaw_rate"] - gyro, 0.02)
  drifting = shown("gyro_drift", [0.06], track)["yaw_rate"] - gyro
  np.testing.assert_allclose(drifting, 0.001 * track.recording_time[0], atol=1e-12)
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
  measured = shown("imu_misalignment", [0.1], track)
  np.testing.assert_allclose(measured["accel_x"], 2.0 * np.cos(0.1))
  np.testing.assert_allclose(measured["accel_y"], -2.0 * np.sin(0.1))


def test_imu_lever_arm_feels_centripetal_and_tangential_acceleration():
  rate = 0.5 + 3.0 * PERIOD * np.arange(20)  # 3 rad/s^2
  measured = shown("imu_lever_arm", [0.05, 0.02], motion(20, yaw_rate=rate).track())
  np.testing.assert_allclose(measured["accel_x"], -(rate**2) * 0.05 - 3.0 * 0.02, atol=1e-9)
  np.testing.assert_allclose(measured["accel_y"], 3.0 * 0.05 - rate**2 * 0.02, atol=1e-9)


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
  measured = shown("clock_drift", [0.005, 0.5], driven.track())
  late = 0.005 * (10.0 + ramp)
  np.testing.assert_allclose(measured["pose_x"], ramp - late, atol=1e-12)
  np.testing.assert_allclose(measured["motor_speed"], np.maximum(ramp - late / 2, 0.0), atol=1e-12)


def test_pose_mount_turns_and_shifts_the_tracked_point():
  track = motion(2, pose_x=1.0, pose_yaw=np.pi / 2).track()
  measured = shown("pose_mount", [0.04, 0.1, 0.02], track)
  np.testing.assert_allclose(measured["pose_x"], 1.0 - 0.02, atol=1e-12)
  np.testing.assert_allclose(measured["pose_y"], 0.1, atol=1e-12)
  np.testing.assert_allclose(measured["pose_yaw"], np.pi / 2 + 0.04)


@pytest.mark.parametrize("name", ["friction_change", "resistance_change"])
def test_of_a_change_only_what_comes_amid_the_driving_is_shown(name):
  """None of it before the driving began or after it ended, all of it in the middle, part of a slow one."""
  change, driving = CATALOGUE[name], Driving(100.0, 300.0, np.zeros((0, 2)))
  share = lambda time, sudden: change.observable_share({f"{name}_time": time, f"{name}_suddenness": sudden}, driving)
  assert share(3.3, 0.7) < 0.01 and share(60.0, 30.0) < 0.01 and share(2000.0, 20.0) < 0.01
  assert share(200.0, 20.0) > 0.99
  # creeping in with 200 s from the start: exp(-120 / 200) - exp(-280 / 200)
  assert share(200.0, 1.0) == pytest.approx(np.exp(-0.6) - np.exp(-1.4))
  assert CATALOGUE["steering_delay"].observable_share({}, driving) == 1.0


@pytest.mark.parametrize("name", ["friction_change", "resistance_change"])
def test_a_change_is_sought_while_the_car_is_driven(name):
  """However long that is: between one drop that is tried and the next, and up to the end, there is no wide gap."""
  change = CATALOGUE[name]
  for first, last in ((0.0, 130.0), (100.0, 3000.0)):
    guesses = change.initial_guesses(Driving(first, last, np.zeros((0, 2))))
    times = np.array([s[f"{name}_time"] for s in guesses if s[f"{name}_suddenness"] > 2.0])
    assert first < times[0] and times[-1] < last
    assert np.all(np.diff(np.log([max(first, 30.0), *times, last])) < np.log(2.0))


@pytest.mark.parametrize("middle", [(0.0, 0.0), (30.0, -20.0)])
@pytest.mark.parametrize("size", [0.5, 2.0, 15.0])
def test_a_slippery_place_is_sought_wherever_the_car_was(middle, size):
  """Nine tenths of the driving lie inside a patch that is tried, wherever the room has its origin."""
  patch, rng = CATALOGUE["friction_patch"], np.random.default_rng(1)
  places = np.array(middle) + size * rng.uniform(-1.0, 1.0, (4000, 2))
  starts = patch.initial_guesses(Driving(0.0, 100.0, places))
  tried = np.array([[s[f"friction_patch_{name}"] for name in ("x", "y", "radius")] for s in starts])
  assert len(tried) <= 36
  away = np.linalg.norm(places[:, None] - tried[:, :2], axis=2) - tried[:, 2]
  assert np.mean(away.min(axis=1) < 0.0) >= 0.9
  if size < 2.0:
    assert tried[:, 2].max() < 0.7


def test_without_a_pose_there_is_no_place_to_seek():
  assert CATALOGUE["friction_patch"].initial_guesses(Driving(0.0, 100.0, np.zeros((0, 2)))) == ({},)
