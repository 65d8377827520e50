"""A speed that poses gave is compared with the car's, over the same window; one that a sensor gave with its wheels'."""

import numpy as np
import pytest

from calibration.fitting.observations import Observations, observe
from calibration.fitting.residual_channels import along_heading, between
from calibration.fitting.start_states import measured_start
from qcar_twin.plant import SIGNALS, START, Prediction
from qcar_twin.recordings.checks.steered import along_only
from qcar_twin.recordings.completed import with_speed
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.vehicle.vehicle import Vehicle

CAR = Vehicle.load()
PUSH = 5.0  # m/s^2
LAUNCHES = {100.0: 2.05, 30.0: 2.0 + 1.0 / 15.0, 10.0: 2.2}  # s: in the middle of a window of poses at so many Hz
SPIN = 2.0  # times the speed of wheels that roll


def way(time: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
  """Way and speed of a car that rolls at 0.3 m/s, and is pushed from one moment on until it drives 2.3 m/s."""
  since = time - LAUNCHES[rate]
  pushed = np.clip(since, 0.0, 2.0 / PUSH)
  driven = 0.3 * time + 0.5 * PUSH * pushed**2 + PUSH * pushed * np.maximum(since - pushed, 0.0)
  return driven, 0.3 + PUSH * pushed


def launch(rate: float, curvature: float = 0.0, heading: bool = True, sensor: bool = False) -> Recording:
  """The launch on a line or a circle, poses at `rate`, Hz, and with a sensor of speed or not."""
  time = np.arange(0.0, 5.0, 1.0 / rate)
  driven, speed = way(time, rate)
  x, y, yaw = arc(driven, curvature)
  columns = {"motor_voltage": speed, "steering_command": 0.0 * time, "pose_x": x, "pose_y": y}
  if heading:
    columns["pose_yaw"] = yaw
  if sensor:
    columns["speed"] = SPIN * speed
  return with_speed(Recording.from_columns("launch", time, columns))[0]


def arc(driven: np.ndarray, curvature: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
  yaw = curvature * driven
  if not curvature:
    return driven, 0.0 * driven, yaw
  return np.sin(yaw) / curvature, (1.0 - np.cos(yaw)) / curvature, yaw


def spinning(observations: Observations, rate: float, curvature: float = 0.0) -> Prediction:
  """What a perfect model says of it, whose wheels turn twice as fast as they roll."""
  segments = observations.stretches.segments
  steps = segments.commands.shape[1] + 1
  driven, speed = way(segments.offset[:, None] + segments.period * np.arange(steps), rate)
  x, y, yaw = arc(driven, curvature)
  signals = np.zeros((1, len(segments), steps, len(SIGNALS)))
  wheels = SPIN * speed / CAR.wheel_radius / CAR.gear_ratio
  for name, value in {"pose_x": x, "pose_y": y, "pose_yaw": yaw, "motor_speed": wheels}.items():
    signals[0, :, :, SIGNALS.index(name)] = value
  return Prediction(signals, segments.period)


def errors(recording: Recording, rate: float, curvature: float = 0.0) -> dict[str, np.ndarray]:
  observations = observe([recording], CAR)
  error = observations.predict(spinning(observations, rate, curvature))[0] - observations.measured
  return {name: error[observations.select(name)] for name in observations.present}


@pytest.mark.parametrize("rate", [100.0, 30.0, 10.0])
@pytest.mark.parametrize("curvature", [0.0, 1.5])
def test_a_launch_with_spinning_wheels_is_met_by_a_perfect_model(rate, curvature):
  """At its corner the speed of a window differs from that of a moment by 3/32 of the window times the push."""
  recording = launch(rate, curvature)
  error = errors(recording, rate, curvature)
  window = float(np.median(np.diff(recording["speed"].time)))
  assert "speed" not in error and len(error["pose_speed"]) > 10
  assert np.abs(error["pose_speed"]).max() < 0.02 * PUSH * window + 2e-3
  moment = recording["speed"].value - way(recording["speed"].time, rate)[1]
  assert np.abs(moment).max() > 0.05 * PUSH * window


def test_a_place_without_a_heading_gives_the_size_of_a_speed():
  error = errors(launch(100.0, heading=False), 100.0)
  assert np.abs(error["path_speed"]).max() < 0.02 * PUSH * 0.1
  assert not {"speed", "pose_speed"} & error.keys()


def test_what_a_sensor_gave_is_the_speed_of_the_wheels():
  error = errors(launch(100.0, sensor=True), 100.0)
  assert np.abs(error["speed"]).max() < 1e-2
  assert not {"pose_speed", "path_speed"} & error.keys()


def test_windows_that_reach_beyond_what_is_simulated_are_not_compared():
  recording = launch(10.0)
  observations = observe([recording], CAR)
  compared = observations.time[observations.select("pose_speed")]
  window = 0.4  # s: five poses
  assert compared.min() > recording.start + 0.38 * window and compared.max() < recording.end - 0.38 * window


def test_an_arc_is_longer_than_its_chord_and_has_a_sign():
  before, after = np.array([0.0, 0.0, 0.0]), np.array([np.sin(0.8), 1.0 - np.cos(0.8), 0.8])
  assert along_heading(before, after) == pytest.approx(0.8, rel=1e-12)
  assert along_heading(after, before) == pytest.approx(-0.8, rel=1e-12)
  assert between(before, after) == pytest.approx(2.0 * np.sin(0.4), rel=1e-12)


@pytest.mark.parametrize("heading", [True, False])
def test_a_speed_whose_pose_was_left_out_is_the_car_s_still(heading):
  """As of a car that turned with no steering command in its log, of which what shows turning is left out."""
  (recording,) = along_only([launch(100.0, heading=heading)])
  error = errors(recording, 100.0)
  assert np.abs(error["pose_speed"]).max() < 0.02 * PUSH * 0.1
  assert not {"speed", "path_speed"} & error.keys()
  start = measured_start(recording, 1.0, CAR, 0.0, False)
  assert start[START.index("velocity_x")] == pytest.approx(0.3, abs=1e-3)


def test_one_speed_alone_tells_no_window_and_still_is_compared():
  whole = launch(100.0)
  speed = whole["speed"]
  few = whole.replace(streams={**whole.streams, "speed": Stream(speed.time[10:11], speed.value[10:11])})
  assert np.isfinite(errors(few, 100.0)["pose_speed"]).all()
