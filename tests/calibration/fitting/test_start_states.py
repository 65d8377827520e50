"""Start states: read off the samples that agree with each other."""

import numpy as np
import pytest

from calibration.fitting.start_states import level, measured_start, read_off_pose
from qcar_twin.plant import START
from qcar_twin.recordings.completed import with_speed
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.vehicle.vehicle import QCAR


def speed(time: np.ndarray) -> np.ndarray:
  """A motor that has just been switched on, rad/s."""
  return 200.0 * (1.0 - np.exp(-time / 0.05))


def launch(rate: float, begin: float = 0.0, noise: float = 0.0, seed: int = 0) -> Stream:
  time = np.arange(begin, 1.0, 1.0 / rate)
  return Stream(time, speed(time) + noise * np.random.default_rng(seed).standard_normal(len(time)))


def state(columns: dict[str, np.ndarray], at_beginning: bool, time: float = 0.0) -> dict[str, float]:
  clock = 0.01 * np.arange(len(columns["yaw_rate"]))
  recording = Recording.from_columns("r", clock, columns)
  return dict(zip(START, measured_start(recording, time, QCAR, 0.3, at_beginning), strict=True))


def test_a_recording_that_begins_in_a_launch_begins_with_its_first_sample():
  stream = launch(100.0)
  line = np.polyval(np.polyfit(stream.time[:7], stream.value[:7], 1), 0.0)
  assert line > 10.0 and abs(level(stream, 0.0, 0.5)) < 1.0


@pytest.mark.parametrize("begin", [0.02, 0.04, 0.08])
def test_a_recording_that_begins_in_mid_launch_begins_where_the_car_is(begin):
  errors = [level(launch(100.0, begin, 1.0, seed), begin, 1.0) - speed(np.array(begin)) for seed in range(100)]
  assert abs(np.mean(errors)) < 1.0 and np.std(errors) < 1.6  # a sample's noise is 1; a mean of 0.06 s is 45 off


def test_steady_driving_is_averaged():
  steady = lambda seed: 100.0 + np.random.default_rng(seed).standard_normal(100)
  errors = [level(Stream(np.arange(0.0, 1.0, 0.01), steady(k)), 0.5, 1.0) - 100.0 for k in range(200)]
  assert np.std(errors) < 0.5  # of single samples it is 1


@pytest.mark.parametrize("rate", [100.0, 20.0])
def test_errors_in_a_launch_are_those_of_samples(rate):
  """Anywhere in a launch: the curve of the rise is no larger an error than two samples' noise."""
  error = [
    level(launch(rate, 0.0, 1.0, k), t, 1.0) - speed(np.array(t)) for k, t in enumerate(np.arange(0.05, 0.2, 0.05))
  ]
  assert np.max(np.abs(error)) < 3.0


def test_a_recording_whose_first_sample_stands_starts_at_rest():
  time = 0.01 * np.arange(100)
  columns = {"motor_speed": speed(time), "yaw_rate": np.full(100, 0.01)}
  assert state(columns, True) | {"steering_angle": 0.0} == dict.fromkeys(START, 0.0)
  assert state(columns, False, 0.5)["yaw_rate"] == pytest.approx(0.01)


def test_sideslip_is_that_of_a_rear_axle_that_rolls():
  columns = {"motor_speed": np.full(200, 1.5 / QCAR.wheel_radius / QCAR.gear_ratio), "yaw_rate": np.full(200, 2.0)}
  begun = state(columns, True)
  assert begun["velocity_x"] == pytest.approx(1.5) and begun["velocity_y"] == pytest.approx(2.0 * QCAR.cg_to_rear)


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_road_wheels_begin_where_the_car_turns_not_where_a_first_command_points(turn):
  """A command of 0.3 rad that is given with the first sample has not acted yet."""
  motor = np.full(200, 1.5 / QCAR.wheel_radius / QCAR.gear_ratio)
  noise = 0.003 * np.random.default_rng(1).standard_normal(200)
  begun = state({"motor_speed": motor, "yaw_rate": turn + noise}, True)
  assert begun["steering_angle"] == pytest.approx(turn * QCAR.wheelbase / 1.5, abs=2e-3)


def test_a_car_that_stands_or_has_no_gyro_begins_with_its_command():
  standing = {"motor_speed": np.zeros(200), "yaw_rate": np.full(200, 0.01)}
  assert state(standing, True)["steering_angle"] == 0.3
  recording = Recording.from_columns("r", 0.01 * np.arange(200), {"motor_speed": np.full(200, 400.0)})
  assert measured_start(recording, 0.0, QCAR, 0.3, True)[START.index("steering_angle")] == 0.3


def test_a_speed_within_its_noise_of_zero_is_none():
  """A full-size car's speed has noise of 0.05 m/s: what it turns by then says nothing of its wheels."""
  random = np.random.default_rng(2)
  columns = {"speed": 0.05 * random.standard_normal(200), "yaw_rate": 0.003 * random.standard_normal(200)}
  columns["speed"][0] = 0.06
  assert state(columns, True) | {"steering_angle": 0.0} == dict.fromkeys(START, 0.0)
  assert state(columns, True)["steering_angle"] == 0.3


@pytest.mark.parametrize("rate", [100.0, 50.0, 10.0])
def test_without_a_gyro_the_heading_tells_how_the_car_turns(rate):
  """A yaw rate that nothing measured was 0: every stretch of such a log began straight ahead, up to 1.5 rad/s off."""
  time, errors = np.arange(0.0, 6.0, 1.0 / rate), []
  for seed in range(40):
    yaw = 0.5 * np.sin(3.0 * time) + 0.005 * np.random.default_rng(seed).standard_normal(len(time))
    recording = Recording.from_columns("r", time, {"speed": np.full(len(time), 1.5), "pose_yaw": yaw})
    at = float(time[len(time) // 2 + seed % 7])
    begun = dict(zip(START, measured_start(recording, at, QCAR, 0.0, False), strict=True))
    errors.append(begun["yaw_rate"] - 1.5 * np.cos(3.0 * at))
  assert np.sqrt(np.mean(np.square(errors))) < 0.1


def test_a_recording_without_a_gyro_that_begins_in_a_turn_begins_with_its_wheels_turned():
  time = 0.02 * np.arange(200)
  yaw = 1.2 * time + 0.003 * np.random.default_rng(2).standard_normal(200)
  recording = Recording.from_columns("r", time, {"speed": np.full(200, 1.5), "pose_yaw": yaw})
  begun = dict(zip(START, measured_start(recording, 0.0, QCAR, 0.0, True), strict=True))
  assert begun["yaw_rate"] == pytest.approx(1.2, abs=0.1)
  assert begun["steering_angle"] == pytest.approx(1.2 * QCAR.wheelbase / 1.5, abs=0.02)


def test_without_gyro_and_heading_the_car_turns_as_it_is_steered():
  clock = 0.01 * np.arange(100)
  recording = Recording.from_columns("r", clock, {"speed": np.full(100, 1.0), "pose_x": clock, "pose_y": 0.0 * clock})
  start = dict(zip(START, measured_start(recording, 0.5, QCAR, 0.3, False), strict=True))
  assert start["yaw_rate"] == pytest.approx(np.tan(0.3) / (QCAR.cg_to_front + QCAR.cg_to_rear), rel=0.05)


@pytest.mark.parametrize("heading", [True, False])
def test_a_speed_without_a_sensor_is_the_slope_of_the_way_there(heading):
  """Not one between two windows of a tenth of a second, of which one may be before the launch."""
  time, random = np.arange(0.0, 3.0, 0.01), np.random.default_rng(3)
  pushed = np.clip(time - 1.05, 0.0, 0.4)
  way = 0.3 * time + 2.5 * pushed**2 + 5.0 * pushed * np.maximum(time - 1.05 - pushed, 0.0)
  along = way + 4e-4 * random.standard_normal(len(time))
  columns = {"motor_voltage": pushed, "pose_x": 0.6 * along, "pose_y": 0.8 * along, "yaw_rate": 0.0 * time}
  if heading:
    columns["pose_yaw"] = np.full(len(time), np.arctan2(0.8, 0.6))
  recording = with_speed(Recording.from_columns("r", time, columns))[0]
  starts = np.arange(0.5, 2.5, 0.02)
  error = lambda speed: np.array([speed(t) for t in starts]) - (0.3 + 5.0 * np.clip(starts - 1.05, 0.0, 0.4))
  read = error(lambda t: measured_start(recording, t, QCAR, 0.0, False)[START.index("velocity_x")])
  between = error(recording["speed"].interpolate)
  assert np.std(read) < 0.03 and np.std(read) < 0.7 * np.std(between)
  assert read_off_pose(recording).tolist() == [name == "velocity_x" for name in START]


def test_a_turn_without_a_gyro_is_read_off_the_pose():
  time = np.arange(0.0, 1.0, 0.01)
  recording = Recording.from_columns("r", time, {"speed": time, "motor_voltage": time, "pose_yaw": time})
  assert [name for name, said in zip(START, read_off_pose(recording), strict=True) if said] == [
    "velocity_y",
    "yaw_rate",
  ]
