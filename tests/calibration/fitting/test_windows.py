"""Stretches of recordings: what is simulated, from where, and what is scored; and values against predictions."""

import dataclasses

import numpy as np
import pytest

from calibration.fitting.observations import CHANNELS, observe
from calibration.fitting.residual_channels import RESIDUALS, along_path, displacement
from calibration.fitting.start_states import measured_start
from calibration.fitting.windows import Cut, cut_recordings, shift_commands
from qcar_twin.plant import SIGNALS, START, Prediction
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.vehicle.vehicle import Vehicle

CAR = Vehicle.load()


def circle(seconds: float = 20.0, name: str = "circle", speed: float = 1.0, rate: float = 0.5) -> Recording:
  """A car that goes round and round at constant speed; poses at 10 Hz, the rest at 100 Hz."""
  time = np.arange(0.0, seconds, 0.01)
  yaw = rate * time
  slow = np.arange(len(time)) % 10 == 0
  blank = lambda values: np.where(slow, values, np.nan)
  return Recording.from_columns(
    name,
    time,
    {
      "motor_voltage": np.full(len(time), 1.0),
      "steering_command": 0.1 * np.sin(time),
      "motor_speed": np.full(len(time), speed / CAR.wheel_radius / CAR.gear_ratio),
      "yaw_rate": np.full(len(time), rate),
      "pose_x": blank(speed / rate * np.sin(yaw)),
      "pose_y": blank(speed / rate * (1 - np.cos(yaw))),
      "pose_yaw": blank(yaw),
    },
    role="identify",
  )


def exact(recording: Recording, observations) -> Prediction:
  """The prediction a perfect model makes of the circle."""
  segments = observations.stretches.segments
  steps = segments.commands.shape[1] + 1
  signals = np.zeros((1, len(segments), steps, len(SIGNALS)))
  time = segments.offset[:, None] + 0.01 * np.arange(steps)
  yaw = 0.5 * time
  for name, value in {
    "pose_x": 2 * np.sin(yaw), "pose_y": 2 * (1 - np.cos(yaw)), "pose_yaw": yaw, "yaw_rate": 0.5 + 0 * time,
    "motor_speed": 1.0 / CAR.wheel_radius / CAR.gear_ratio + 0 * time,
  }.items():  # fmt: skip
    signals[0, :, :, SIGNALS.index(name)] = value
  # a free run drifts: turn and move every segment's world, which displacements must not notice
  turn = 0.7
  x, y = signals[..., 0].copy(), signals[..., 1].copy()
  signals[..., 0], signals[..., 1] = np.cos(turn) * x - np.sin(turn) * y + 3, np.sin(turn) * x + np.cos(turn) * y - 5
  signals[..., 2] += turn
  return Prediction(signals, 0.01)


def test_every_measured_value_is_scored_once_and_met_by_a_perfect_model():
  recording = circle()
  observations = observe([recording], CAR)
  error = observations.predict(exact(recording, observations))[0] - observations.measured
  assert np.abs(error).max() < 1e-3  # interpolation on the 10 ms grid
  rates = observations.select("yaw_rate")
  assert rates.sum() == len(recording["yaw_rate"].time) - 1  # the first row is where the simulation starts
  assert len(np.unique(observations.time[rates])) == rates.sum()


def placed(noise: float = 0.0, speed: float = 1.0) -> Recording:
  """The circle without a heading, at places with noise, m."""
  whole, random = circle(speed=speed), np.random.default_rng(0)
  rough = lambda stream: Stream(stream.time, stream.value + noise * random.standard_normal(len(stream)))
  streams = {k: rough(v) if k.startswith("pose") else v for k, v in whole.streams.items() if k != "pose_yaw"}
  return whole.replace(streams=streams)


def test_places_without_a_heading_are_compared_as_the_way_seen_along_the_one_before():
  observations = observe([placed()], CAR)
  assert {"path_forward", "path_left"} <= set(observations.present)
  assert not {"pose_forward", "pose_left", "pose_turn"} & set(observations.present)
  error = observations.predict(exact(placed(), observations))[0] - observations.measured
  assert np.abs(error).max() < 1e-3
  left = observations.measured[observations.select("path_left")]
  np.testing.assert_allclose(left, 4.0 * np.sin(0.125) * np.sin(0.25), atol=1e-3)  # chords of 0.25 rad on 2 m


def test_a_place_that_hardly_moved_has_no_direction():
  assert "path_left" in observe([placed(noise=0.01)], CAR).present
  assert "path_left" not in observe([placed(noise=0.01, speed=0.1)], CAR).present


def test_the_noise_of_a_way_along_the_path_is_that_of_its_three_places():
  still, random = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]])[:, None], np.random.default_rng(1)
  ways = along_path(*(still + 0.01 * random.standard_normal((3, 20000, 2))))
  said = [RESIDUALS[name].noise(0.01, 0.01) for name in ("path_forward", "path_left")]
  np.testing.assert_allclose(ways.std(axis=0), said, rtol=0.02)


def test_recordings_of_one_name_are_refused():
  """Measured values go to their recording by name: two would be scored against each other's commands."""
  with pytest.raises(ValueError, match="2 recordings are called '.*': give each a name of its own"):
    cut_recordings([circle(), circle()], CAR)


def test_stretches_start_from_what_was_measured():
  stretches = cut_recordings([circle()], CAR, Cut(length=5.0))
  starts = stretches.segments.start
  assert len(starts) >= 4
  np.testing.assert_allclose(starts[:, START.index("velocity_x")], 1.0, rtol=1e-9)
  np.testing.assert_allclose(starts[:, START.index("yaw_rate")], 0.5, rtol=1e-9)
  np.testing.assert_allclose(starts[1:, START.index("pose_yaw")], 0.5 * stretches.segments.offset[1:], atol=1e-6)
  lead = stretches.first[1:] - stretches.segments.offset[1:]
  np.testing.assert_allclose(lead, 0.4, atol=1e-9)  # the warm-up


def test_history_is_that_of_the_data_set_whatever_is_cut_in_which_order():
  one, two = circle(10.0, "one"), circle(10.0, "two")
  history = cut_recordings([one, two], CAR, Cut(length=20.0)).segments.history
  np.testing.assert_allclose(history[1], [len(one.commands(0.01)[0]) * 0.01] * 2, rtol=1e-9)  # 1 V: V^2 s = s
  three = dataclasses.replace(two, name="three", role="validate", session="tomorrow")
  known = DataSet("circles", (one, two, three)).recordings
  alone = cut_recordings([known[2], known[1]], CAR, Cut(length=20.0)).segments.history
  np.testing.assert_allclose(alone, [[20.0, 20.0], [10.0, 10.0]], atol=0.05)
  again = DataSet("part", known[1:]).recordings  # part of a data set does not forget
  assert [r.before for r in again] == [r.before for r in known[1:]]


def test_a_long_data_set_is_sampled_evenly_and_no_recording_is_lost():
  recordings = [circle(60.0, f"r{i}") for i in range(3)]
  stretches = cut_recordings(recordings, CAR, Cut(length=5.0, most=60.0))
  driven = stretches.segments.steps.sum() * 0.01
  assert 45.0 < driven < 75.0
  assert set(stretches.segments.recording) == {"r0", "r1", "r2"}


def test_what_is_kept_of_a_long_data_set_is_not_beginnings_alone():
  """A twin fitted to the first seconds of every recording never sees a corner that comes later."""
  recordings = [circle(60.0, f"r{i}") for i in range(12)]
  for most, evenly in ((60.0, False), (240.0, True), (240.0, False)):  # fewer than two of every recording, and more
    segments = cut_recordings(recordings, CAR, Cut(length=5.0, most=most, evenly=evenly)).segments
    assert segments.steps.sum() * 0.01 <= 1.1 * most
    thirds = np.histogram(segments.offset, bins=3, range=(0.0, 60.0))[0]
    assert thirds.min() >= len(segments.offset) / 12  # half of them are spread evenly


def test_short_recordings_are_kept_beside_long_ones():
  recordings = [circle(200.0, "long"), *(circle(6.0, f"short{i}") for i in range(3))]
  segments = cut_recordings(recordings, CAR, Cut(length=5.0, most=60.0)).segments
  assert set(segments.recording) == {"long", "short0", "short1", "short2"}
  assert segments.steps.sum() * 0.01 <= 66.0


def test_commands_shift_by_whole_periods_and_hold_at_the_ends():
  commands = np.arange(6.0).reshape(3, 2)
  np.testing.assert_array_equal(shift_commands(commands, 1), commands[[0, 0, 1]])
  np.testing.assert_array_equal(shift_commands(commands, -1), commands[[1, 2, 2]])
  assert shift_commands(commands, 0) is commands


def test_the_wheels_angle_goes_on_from_stretch_to_stretch():
  """1 m/s all the time: the angle is the distance over the wheel's radius since the start, warm-ups included."""
  segments = cut_recordings([circle(), circle(12.0, "other")], CAR, Cut(length=5.0)).segments
  since = segments.offset[:, None] + 0.01 * np.arange(segments.commands.shape[1] + 1)
  assert np.sum(segments.offset == 0.0) == 2 and segments.wheel_angle is not None
  for angle, time, steps in zip(segments.wheel_angle, since, segments.steps, strict=True):
    np.testing.assert_allclose(angle[: steps + 1], time[: steps + 1] / CAR.wheel_radius, rtol=1e-9)


def test_the_wheels_angle_bridges_gaps_and_late_beginnings_of_the_encoder():
  whole = circle()
  time, speed = whole["motor_speed"].time, whole["motor_speed"].value * np.linspace(1.0, 2.0, 2000)
  gap = (time > 0.3) & ((time < 7.0) | (time > 7.4))
  angles = []
  for there in (time >= 0.0, gap):
    streams = {**whole.streams, "motor_speed": Stream(time[there], speed[there])}
    angles.append(cut_recordings([whole.replace(streams=streams)], CAR, Cut(length=5.0)).segments.wheel_angle)
  np.testing.assert_allclose(angles[1], angles[0], atol=0.1)  # 0.3 s at a speed known to 1.5 %
  blind = whole.replace(streams={k: v for k, v in whole.streams.items() if k != "motor_speed"})
  assert np.isnan(cut_recordings([blind], CAR, Cut(length=5.0)).segments.wheel_angle).all()


def test_a_recording_too_short_to_simulate_is_refused():
  with pytest.raises(ValueError, match="at least 0.2 s with a motor_voltage"):
    cut_recordings([circle(0.15)], CAR)


def test_a_car_of_another_drive_is_refused_with_both_cures():
  time = np.arange(0.0, 20.0, 0.01)
  columns = {"motor_duty": 0.2 + 0.0 * time, "speed": 1.0 + 0.0 * time, "steering_command": 0.0 * time}
  by_duty = Recording.from_columns("run", time, columns)
  said = "correct drive in .vehicle. of dataset.toml, or name a twin of this car where one was named"
  with pytest.raises(ValueError, match=said):
    cut_recordings([by_duty], Vehicle(drive="voltage"), Cut())


def test_a_start_at_rest_is_at_rest():
  start = measured_start(circle(2.0, speed=0.01), 0.0, CAR, 0.9, at_beginning=True)
  assert start[START.index("velocity_x")] == 0.0
  assert start[START.index("steering_angle")] == CAR.max_steering  # a command beyond the lock


def test_displacement_is_seen_from_the_first_pose():
  before, after = np.array([1.0, 2.0, np.pi / 2]), np.array([1.0, 5.0, np.pi])
  np.testing.assert_allclose(displacement(before, after), [3.0, 0.0, np.pi / 2], atol=1e-12)


def test_speed_that_never_carries_a_sign_is_compared_without_one():
  recording = circle()
  columns = {"motor_voltage": np.full(2000, -1.0), "speed": np.full(2000, 1.0)}
  unsigned = Recording.from_columns("r", recording["yaw_rate"].time, columns, role="identify")
  observations = observe([unsigned], CAR)
  signals = np.full(
    (1, len(observations.stretches.segments), observations.stretches.segments.commands.shape[1] + 1, 10), -100.0
  )
  assert observations.unsigned_speed
  assert (observations.predict(Prediction(signals, 0.01)) > 0).all()
  assert set(observations.channel) == {CHANNELS.index("speed")}


def test_values_split_between_recordings_are_predicted_as_before():
  """From the same signals each part predicts what the whole predicts there, poses looked up a second earlier, too."""
  recordings = [circle(20.0, "first"), circle(7.0, "second", speed=0.7), circle(9.0, "third", rate=0.3)]
  whole = observe(recordings, CAR)
  count = int(np.sum(whole.recording < 2))
  head, tail = whole.split(count)
  assert (len(head), len(tail)) == (count, len(whole) - count)
  segments = [o.stretches.segments for o in (whole, head, tail)]
  assert len(segments[1]) + len(segments[2]) == len(segments[0]) and set(segments[2].recording) == {"third"}
  drawn = np.random.default_rng(0).standard_normal((2, *segments[0].measured_pose.shape[:2], len(SIGNALS)))
  predicted = whole.predict(Prediction(drawn, 0.01))
  np.testing.assert_array_equal(head.predict(Prediction(drawn[:, : len(segments[1])], 0.01)), predicted[:, :count])
  np.testing.assert_array_equal(tail.predict(Prediction(drawn[:, len(segments[1]) :], 0.01)), predicted[:, count:])
  for name in ("measured", "channel", "recording", "block", "time"):
    parts = np.concatenate([getattr(head, name), getattr(tail, name)])
    np.testing.assert_array_equal(parts, getattr(whole, name))
  everything, nothing = whole.split(len(whole))
  assert len(everything) == len(whole) and len(nothing) == 0
  with pytest.raises(ValueError, match="sort recordings by role"):
    whole.split(3)
