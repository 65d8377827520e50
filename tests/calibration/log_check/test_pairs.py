"""Sensors of one motion: what was done to one of them is what the comparison says, within its own deviations."""

import numpy as np
import pytest

from calibration.fitting.noise import noise_models
from calibration.log_check.motions import REGIMES, Wheels, motions, regimes
from calibration.log_check.pairs import compare
from calibration.log_check.ready import fitted_ages, told_without_a_model
from calibration.log_check.wide_lag import sums_by_lag, wide_lag
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.recordings.drives import STD, VEHICLE, recording

AHEAD = 0.005  # s: the poses of these drives are summed up, half a sample ahead of what they are the integral of
CAR = Vehicle.from_dataset(VEHICLE, STD)


def changed(run: Recording, channel: str, late: float = 0.0, scale: float = 1.0, bias: float = 0.0) -> Recording:
  stream = run[channel]
  return run.replace(streams={**run.streams, channel: Stream(stream.time + late, scale * stream.value + bias)})


def comparison(name: str, runs: list[Recording]):
  wheels = Wheels.of(CAR, runs)
  (motion,) = (m for m in motions(wheels, runs) if m.name == name)
  return compare(motion, wheels, runs, noise_models(runs))


def drives(count: int = 3, **change) -> list[Recording]:
  runs = [recording(f"run_{k}", seed=k, seconds=30.0) for k in range(count)]
  return [changed(r, **change) for r in runs] if change else runs


@pytest.mark.parametrize(
  ("name", "channel", "late", "scale", "bias"),
  [
    ("turning", "yaw_rate", 0.0, 1.0, 0.0),
    ("turning", "yaw_rate", 0.045, 1.03, 0.02),
    ("turning", "yaw_rate", -0.02, 0.97, -0.01),
    ("turning", "pose_yaw", 0.06, 1.0, 0.0),
    ("driving", "motor_speed", 0.08, 1.0, 0.0),
    ("driving", "motor_speed", 0.0, 1.05, 0.0),
    ("speeding up and slowing down", "accel_x", 0.02, 1.1, 0.3),
    ("going round", "accel_y", 0.03, 0.9, 0.2),
  ],
)
def test_a_lag_a_scale_and_a_bias_are_found_where_they_were_put(name, channel, late, scale, bias):
  c = comparison(name, drives(channel=channel, late=late, scale=scale, bias=bias))
  sign, ahead = 1.0 if channel in c.motion.compared else -1.0, AHEAD if "pose_yaw" in c.motion.reference else 0.0
  assert c.lag.value == pytest.approx(sign * late + ahead, abs=max(4.0 * c.lag.std, 0.002))
  assert c.scale.value == pytest.approx(scale, abs=max(4.0 * c.scale.std, 0.003))
  assert c.bias.value == pytest.approx(bias, abs=max(4.0 * c.bias.std, 0.005))
  assert c.lag.std < 0.01 and c.scale.std < 0.02 and c.correlation > 0.95 and c.seconds > 20.0


def test_a_value_that_a_slow_publisher_holds_is_late_by_its_age():
  runs = []
  for run in drives():
    stream = run["motor_speed"]
    slow = Stream(stream.time[::10] + 0.05, stream.value[::10])
    runs.append(run.replace(streams={**run.streams, "motor_speed": slow}))
  c = comparison("driving", runs)
  assert c.lag.value == pytest.approx(0.05 + AHEAD, abs=max(4.0 * c.lag.std, 0.004))


def test_a_speed_that_never_carries_a_sign_is_compared_by_its_size():
  runs = []
  for run in drives():
    speed, back = run["motor_speed"], run.name == "run_1"
    heading = run["pose_yaw"]
    streams = {**run.streams, "motor_speed": Stream(speed.time, np.abs(speed.value))}
    if back:  # the same path, driven backwards
      streams["pose_yaw"] = Stream(heading.time, heading.value + np.pi)
    runs.append(run.replace(streams=streams))
  c = comparison("driving", runs)
  assert c.correlation > 0.99 and c.scale.value == pytest.approx(1.0, abs=0.01)


def test_the_deviations_are_those_of_repeated_drives():
  scales = [(c.scale.value, c.scale.std) for k in range(12) for c in [comparison("turning", _seeded(k))]]
  values, stds = np.array(scales).T
  assert 0.4 < np.std(values) / np.median(stds) < 2.5


def _seeded(k: int) -> list[Recording]:
  return [recording(f"run_{i}", seed=100 * k + i, seconds=30.0) for i in range(2)]


def test_where_nothing_moves_or_little_was_driven_nothing_is_said():
  time = np.arange(3000) / 100.0
  noise = lambda k, size: size * np.random.default_rng(k).standard_normal(len(time))
  still = {"motor_voltage": 0 * time, "motor_speed": 0 * time, "yaw_rate": noise(1, 0.01), "pose_yaw": noise(2, 1e-3)}
  c = comparison("turning", [Recording.from_columns("still", time, still)])
  assert "is not 3 times the reference's noise" in c.why_not and np.isnan(c.scale.value)
  assert "less than 18 s hold both" in comparison("turning", [recording(seconds=6.0)]).why_not


def test_windows_are_called_by_how_the_car_was_driven():
  time = np.arange(1000) / 100.0
  speed = np.where(time < 3.0, 1.0, np.where(time < 6.0, 1.0 + 0.5 * (time - 3.0), 2.5))
  rate = np.where(time < 8.0, 0.0, -1.0)
  columns = {"motor_voltage": speed, "speed": speed, "yaw_rate": rate}
  run = Recording.from_columns("run", time, columns)
  labels = regimes(Wheels("speed", 1.0), run, np.array([1.0, 4.0, 7.0, 9.0]), 0.2)
  assert labels.tolist() == ["steady", "speeding up", "steady", "turning right"] and set(labels) <= set(REGIMES)


@pytest.mark.parametrize(("late", "told"), [(0.04, True), (-0.02, False)])
def test_an_encoder_that_is_late_has_an_age_and_one_that_is_early_wheels_that_slip(late, told):
  time = np.arange(0.0, 60.0, 0.01)
  speed = lambda t: 1.0 + 0.5 * np.sin(1.3 * t) + 0.3 * np.sin(2.9 * t)
  noise = np.random.default_rng(4)
  place = np.cumsum(speed(time)) * 0.01 + 0.001 * noise.standard_normal(len(time))
  motor = speed(time - late) / CAR.wheel_radius / CAR.gear_ratio + noise.standard_normal(len(time))
  columns = {"motor_speed": motor, "pose_x": place, "pose_y": 0.0 * time, "pose_yaw": 0.0 * time}
  ages = told_without_a_model([Recording.from_columns("r", time, columns)], CAR)
  assert ("encoder_latency" in ages) == told
  if told:
    value, std = ages["encoder_latency"]
    assert value == pytest.approx(late, abs=0.006) and std >= 0.005


@pytest.mark.parametrize(
  ("channel", "late", "age"), [("yaw_rate", 0.045, "imu_latency"), ("pose_yaw", 0.06, "pose_latency")]
)
def test_ages_count_from_what_speaks_first(channel, late, age):
  """A gyro does not show a turn before the car turns: a pose that shows it later is late."""
  ages = fitted_ages(DataSet("d", tuple(drives(channel=channel, late=late))), CAR)
  assert {name for name in ages if name in ("imu_latency", "pose_latency")} == {age}
  sign = 1.0 if age == "imu_latency" else -1.0
  assert ages[age][0] == pytest.approx(late + sign * AHEAD, abs=0.003)


@pytest.mark.parametrize("share", [0.04, 0.3])
def test_turns_that_change_sides_are_no_command_with_the_other_sign_half_a_period_away(share):
  """Half a period on, with the other sign, a drive in turns to either side looks like itself: such a lag counts only
  where the two do not go together as they are."""
  step, half = 0.05, 96  # turns of 4.8 s
  time = step * np.arange(600)
  side = np.where(np.floor(time / (step * half)) % 2, 1.0, -1.0)
  own = np.sqrt(share) * np.random.default_rng(3).normal(size=len(time) + half)
  x, y = side + own[: len(time)], side - own[half:]  # y(t) = -x(t + half), but for the ends

  def correlation(sums):
    n, x, y, xx, xy, yy = np.moveaxis(sums, -1, 0)
    return (xy / n - x * y / n**2) / np.sqrt((xx / n - (x / n) ** 2) * (yy / n - (y / n) ** 2))

  lag, elsewhere = wide_lag([sums_by_lag(x, y)], correlation, step, (-0.4, 0.4))
  assert lag == (0.0 if share < 0.1 else pytest.approx(-4.8)) and elsewhere


def test_a_peak_whose_foot_lies_among_near_lags_is_followed_to_its_top():
  """Of a heading once a second the peak is a second wide: the lag 0.6 s away is none of a drive that repeats itself."""
  step, late = 0.05, 12
  random = np.random.default_rng(7)
  motion = np.convolve(random.normal(size=900 + late), np.full(60, 1.0 / 60.0), "same")  # means over 3 s
  x, y = motion[late:], motion[:-late]

  def correlation(sums):
    n, x, y, xx, xy, yy = np.moveaxis(sums, -1, 0)
    return (xy / n - x * y / n**2) / np.sqrt((xx / n - (x / n) ** 2) * (yy / n - (y / n) ** 2))

  lag, elsewhere = wide_lag([sums_by_lag(x, y)], correlation, step, (-0.3, 0.5))
  assert lag == pytest.approx(step * late) and elsewhere
