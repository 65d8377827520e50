"""Offline runs over recordings, dead reckoning, and the measures of quality."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from qcar_twin.estimation import offline
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from qcar_twin.vehicle.drive import DRIVES
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.estimation.estimation_rig import CAR, PERIOD, hold, journey, position_errors, rms, run


def recording_of(trip, **shift):
  """The journey as a recording; `shift` moves a channel's stamps."""
  columns = {
    "motor_voltage": trip.commands[:, 0],
    "steering_command": trip.commands[:, 1],
    "speed": trip.speed,
    "yaw_rate": trip.yaw_rate,
    "accel_x": trip.accel[:, 0],
    "accel_y": trip.accel[:, 1],
    **{name: trip.fix[:, i] for i, name in enumerate(("pose_x", "pose_y", "pose_yaw", "pose_score"))},
  }
  streams = {}
  for name, value in columns.items():
    good = np.isfinite(value)
    if good.any():
      streams[name] = Stream(trip.time[good] + shift.get(name, 0.0), value[good])
  return Recording("journey", streams)


def test_a_recording_gives_the_online_estimates():
  trip = journey(5.0)
  online, _ = run(trip)
  result = offline.filter_recording(recording_of(trip), CAR)
  x = np.array([e.pose_x for e in online])
  np.testing.assert_allclose(result.value["pose_x"], x, atol=1e-12)
  np.testing.assert_allclose(result.std["speed"], [e.std["speed"] for e in online], atol=1e-12)
  np.testing.assert_allclose(result.covariance, [e.covariance for e in online], atol=1e-15)
  assert result.valid.all() and not result.reasons
  assert set(result.columns()) >= {"time", "pose_x", "pose_x_std", "sideslip_angle", "valid"}


def test_known_lateness_of_the_stamps_is_undone():
  """An IMU stamped 100 ms after it measured is as good as one stamped right, when the filter is told."""
  trip = journey(10.0)
  late = recording_of(trip, yaw_rate=0.1, accel_x=0.1, accel_y=0.1, speed=0.1)
  told = offline.filter_recording(late, CAR, lateness=dict.fromkeys(("yaw_rate", "accel_x", "accel_y", "speed"), 0.1))
  ignorant = offline.filter_recording(late, CAR)
  right = offline.filter_recording(recording_of(trip), CAR)

  def turning(result):
    rate = np.interp(trip.time, result.time, result.value["yaw_rate"])
    return rms(rate[300:-20] - trip.truth[300:-20, 5])

  assert turning(told) == pytest.approx(turning(right), rel=0.05)
  assert turning(told) < 0.6 * turning(ignorant)


def test_latency_of_the_lidar_costs_little():
  trip = journey(10.0)
  late = offline.filter_recording(
    recording_of(trip), CAR, latency=dict.fromkeys(("pose_x", "pose_y", "pose_yaw", "pose_score"), 0.1)
  )
  estimates, _ = run(trip)
  count = len(trip.time)
  errors = np.hypot(late.value["pose_x"][:count] - trip.truth[:, 0], late.value["pose_y"][:count] - trip.truth[:, 1])
  assert rms(errors[300:]) < 1.3 * rms(position_errors(trip, estimates)[300:])


def test_recording_without_a_pose_names_the_cure():
  trip = journey(1.0)
  trip.fix[:] = np.nan
  with pytest.raises(RecordingError, match="has no pose_x, pose_y, pose_yaw"):
    offline.filter_recording(recording_of(trip), CAR)


def test_motor_speed_is_preferred_to_speed():
  streams = {name: Stream(np.arange(3.0), np.ones(3)) for name in ("speed", "motor_speed", "pose_x")}
  channels = {event.channel for event in offline.events_of(Recording("r", streams))}
  assert channels == {"motor_speed", "pose_x"}


# -- what drives the car -------------------------------------------------------------------------


def renamed(recording, channel, factor=1.0, **more):
  """The same run with the drive's command as another channel, divided by a factor."""
  streams = dict(recording.streams)
  voltage = streams.pop("motor_voltage")
  return recording.replace(streams={**streams, channel: Stream(voltage.time, voltage.value / factor), **more})


@pytest.mark.parametrize("drive", sorted(DRIVES))
def test_the_command_of_every_drive_is_heard(drive):
  recording = recording_of(journey(3.0))
  other = renamed(recording, DRIVES[drive].channel)
  right = offline.filter_recording(recording, CAR)
  for vehicle in (None, Vehicle(drive=drive)):
    heard = offline.filter_recording(other, CAR, vehicle=vehicle)
    np.testing.assert_array_equal(heard.value["speed"], right.value["speed"])


def test_a_duty_is_of_the_voltage_that_the_battery_had():
  recording, supply = recording_of(journey(3.0)), 12.0
  duty = renamed(recording, "motor_duty", 10.0, battery_voltage=Stream(np.arange(3.0), np.full(3, 10.0)))
  car = dataclasses.replace(CAR, drive_gain=CAR.drive_gain * supply)  # per duty of the stated supply
  heard = offline.filter_recording(duty, car, vehicle=Vehicle(drive="duty", supply_voltage=supply))
  right = offline.filter_recording(recording, CAR)
  np.testing.assert_allclose(heard.value["speed"], right.value["speed"], atol=1e-12)


def test_a_duty_that_is_held_goes_with_the_battery():
  streams = {name: Stream(np.arange(2.0), np.ones(2)) for name in ("pose_x", "pose_y", "pose_yaw")}
  streams |= {"motor_duty": Stream([0.5], [0.5]), "battery_voltage": Stream([0.0, 1.0, 2.0], [12.0, 9.0, 6.0])}
  events = offline.events_of(Recording("r", streams), vehicle=Vehicle(drive="duty", supply_voltage=12.0))
  heard = [(event.stamp, event.value) for event in events if event.channel == "motor_voltage"]
  assert heard == [(0.5, 0.4375), (1.0, 0.375), (2.0, 0.25)]


def test_a_command_of_another_drive_names_file_channel_and_cure():
  recording = renamed(recording_of(journey(1.0)), "speed_command").replace(file="run.csv")
  with pytest.raises(RecordingError, match=r"run\.csv: .*speed_command.*motor_voltage.*drive in \[vehicle\]"):
    offline.filter_recording(recording, CAR, vehicle=Vehicle())


def test_a_command_that_was_not_logged_is_named_with_a_cure():
  whole = recording_of(journey(1.0))
  assert offline.unheard(whole, Vehicle()) == []
  kept = {name: stream for name, stream in whole.streams.items() if name != "motor_voltage"}
  (said,) = offline.unheard(dataclasses.replace(whole, streams=kept), Vehicle())
  assert whole.name in said and "motor_voltage was not logged" in said and "map it" in said


def test_dead_reckoning_drives_a_circle():
  speed, rate, count = 0.5, 0.4, 2000
  track = offline.dead_reckoning(
    np.array([1.0, 2.0, 0.3]), np.full(count, speed), np.full(count, rate), np.zeros(count), CAR, PERIOD
  )
  yaw = 0.3 + rate * PERIOD * np.arange(count)
  radius = speed / rate
  np.testing.assert_allclose(track[:, 2], yaw, atol=1e-9)
  np.testing.assert_allclose(track[:, 0], 1.0 + radius * (np.sin(yaw) - np.sin(0.3)), atol=1e-4)
  np.testing.assert_allclose(track[:, 1], 2.0 - radius * (np.cos(yaw) - np.cos(0.3)), atol=1e-4)


def test_dead_reckoning_holds_over_lost_samples():
  speed = np.full(100, 0.5)
  speed[20:40] = np.nan
  track = offline.dead_reckoning(np.zeros(3), speed, np.zeros(100), np.zeros(100), CAR)
  assert track[-1, 0] == pytest.approx(0.5 * 0.99)


def test_dead_reckoning_drifts_where_the_filter_does_not():
  trip = journey(40.0)
  biased = trip.yaw_rate + 0.01
  track = offline.dead_reckoning(trip.truth[0, [0, 1, 3]], trip.speed, biased, trip.commands[:, 1], CAR)
  trip.yaw_rate = biased
  estimates, _ = run(trip, FilterSettings())
  drift = np.hypot(*(track[-1, :2] - trip.truth[-1, :2]))
  assert drift > 0.5 and position_errors(trip, estimates)[-1] < 0.02


@given(st.floats(-20, 20), st.floats(-20, 20))
def test_angle_errors_are_wrapped(a, b):
  error = float(offline.angle_error(np.array(a), np.array(b)))
  assert -np.pi < error <= np.pi + 1e-12
  assert np.cos(error) == pytest.approx(np.cos(a - b), abs=1e-9)


def test_holding_voltage_of_the_rig_holds():
  assert journey(2.0, speed=0.7, amplitude=0.0).truth[-1, 2] == pytest.approx(0.7, rel=1e-9)
  assert hold(0.0) == 0.0


# -- settings from data --------------------------------------------------------------------------


def test_scores_to_one_and_scores_to_a_hundred_mean_the_same():
  trip = journey(3.0)
  trip.fix[::10, 3] = np.linspace(20.0, 95.0, len(trip.fix[::10]))
  percent = recording_of(trip)
  trip.fix[:, 3] /= 100.0
  unit = recording_of(trip)
  one = FilterSettings().with_scores_of([percent])
  two = FilterSettings().with_scores_of([unit])
  assert (one.score_full, two.score_full) == (100.0, 1.0)
  a, b = offline.filter_recording(percent, CAR, one), offline.filter_recording(unit, CAR, two)
  np.testing.assert_allclose(a.value["pose_x"], b.value["pose_x"], atol=1e-12)
  low, high = two.pose_noise(0.2)[0], two.pose_noise(0.9)[0]
  assert low > 2.0 * high


def test_standstill_noise_becomes_filter_settings():
  from qcar_twin.sensors.noise import Standstill

  def channel(offset, white, coloured=0.0, correlation=float("nan"), interval=0.01):
    return Standstill(offset, white, 0.0, coloured, correlation, interval, 1000)

  noise = {
    "yaw_rate": channel(0.004, 0.015),
    "accel_x": channel(-0.1, 0.2),
    "pose_x": channel(1.0, 0.003, 0.004, 0.4, 0.2),
    "pose_y": channel(2.0, 0.003, 0.004, 0.6, 0.2),
    "pose_yaw": channel(0.1, 0.01, interval=0.2),
    "motor_speed": channel(0.0, 0.0),
  }
  noisy = FilterSettings().with_noise(noise, rolling_radius=0.003)
  assert (noisy.yaw_rate_bias, noisy.yaw_rate_std, noisy.accel_x_bias) == (0.004, 0.015, -0.1)
  assert noisy.speed_std == FilterSettings().speed_std
  assert (noisy.lidar_correlation, noisy.lidar_interval) == (pytest.approx(0.5), 0.2)
  variance = noisy.position_variance(noisy.score)
  assert variance == pytest.approx(0.005**2) and noisy.yaw_variance(noisy.score) == pytest.approx(1e-4)
