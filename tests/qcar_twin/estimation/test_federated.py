"""The online filter: late and out-of-order arrivals, rates, standstill, reverse, bookkeeping, cost in steps."""

import math

import numpy as np
import pytest

from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.local_filters import LocalFilters
from qcar_twin.estimation.settings import FilterSettings
from tests.qcar_twin.estimation.estimation_rig import CAR, PERIOD, hold, journey, position_errors, rms, run


def last(estimates):
  e = estimates[-1]
  return np.array([e.pose_x, e.pose_y, e.pose_yaw, e.speed, e.sideslip_angle, e.yaw_rate, *e.covariance])


def test_follows_the_car_better_than_any_fix():
  trip = journey(30.0)
  estimates, federated = run(trip)
  late = slice(200, None)
  fixes = np.isfinite(trip.fix[:, 0])
  lidar = np.hypot(*(trip.fix[fixes, :2] - trip.truth[fixes, :2]).T)
  assert rms(position_errors(trip, estimates)[late]) < 0.5 * rms(lidar)
  sideslip = np.array([e.sideslip_angle for e in estimates]) - trip.truth[:, 4]
  assert rms(sideslip[late]) < 2e-3
  assert all(e.valid for e in estimates) and not federated.refused


@pytest.mark.parametrize("latency", [1, 5, 30])
def test_late_fixes_end_in_the_same_estimate_as_punctual_ones(latency):
  """The replay is exact: once everything has arrived, nothing tells when it came."""
  trip = journey(6.0)
  trip.fix[-latency:] = np.nan  # let the last ones arrive
  punctual, late = run(trip)[0], run(trip, latency=latency)[0]
  np.testing.assert_array_equal(last(punctual), last(late))


def test_shuffled_arrival_ends_in_the_same_estimate():
  trip = journey(3.0)
  expected = last(run(trip)[0])
  federated = FederatedFilter(CAR)
  rng = np.random.default_rng(0)
  samples = []
  for k, stamp in enumerate(trip.time):
    samples += [(stamp, "motor_voltage", trip.commands[k, 0]), (stamp, "steering_command", trip.commands[k, 1])]
    samples += [(stamp, "speed", trip.speed[k]), (stamp, "yaw_rate", trip.yaw_rate[k])]
    samples += [(stamp, "accel_x", trip.accel[k, 0]), (stamp, "accel_y", trip.accel[k, 1])]
    if np.isfinite(trip.fix[k, 0]):
      samples += [
        (stamp, name, v) for name, v in zip(("pose_x", "pose_y", "pose_yaw", "pose_score"), trip.fix[k], strict=True)
      ]
  arrival = np.array([s[0] for s in samples]) + rng.uniform(0.0, 0.4, len(samples)) * (np.arange(len(samples)) > 12)
  position = 0
  order = np.argsort(arrival, kind="stable")
  for now in np.arange(0.0, 3.5, PERIOD):
    while position < len(order) and arrival[order[position]] <= now:
      federated.update(*samples[order[position]])
      position += 1
    if now < trip.time[-1]:
      federated.estimate(now)
  np.testing.assert_allclose(last([federated.estimate(trip.time[-1])]), expected, atol=1e-12)


def test_repeated_stamps_change_nothing_and_are_counted():
  trip = journey(2.0)
  expected = last(run(trip)[0])
  federated = FederatedFilter(CAR)
  twice = federated.update

  def update(*sample):
    twice(*sample)
    twice(sample[0], sample[1], sample[2] + 7.0 * (sample[1] not in ("motor_voltage", "steering_command")))

  federated.update = update
  estimates, _ = run(trip, federated=federated)
  np.testing.assert_array_equal(last(estimates), expected)
  assert federated.refused["speed", "repeated"] == len(trip.time)
  assert federated.refused["pose_x", "repeated"] == np.isfinite(trip.fix[:, 0]).sum()


def test_samples_older_than_the_buffer_or_from_the_future_are_refused():
  trip = journey(4.0)
  _, federated = run(trip)
  before = last([federated.estimate(trip.time[-1])])
  federated.update(trip.time[-1] - 1.5, "pose_x", 99.0)
  federated.update(trip.time[-1] + 1e6, "yaw_rate", 0.0)
  federated.update(-5.0, "speed", 3.0)
  np.testing.assert_array_equal(last([federated.estimate(trip.time[-1])]), before)
  assert federated.refused["pose_x", "too late"] == 1
  assert federated.refused["yaw_rate", "in the future"] == 1
  assert federated.refused["speed", "too late"] == 1


def test_a_fix_between_two_periods_is_moved_to_its_own_time():
  """At 2 m/s, 4 ms are 8 mm: stamps off the grid must not show as an error."""
  trip = journey(8.0, speed=2.0, amplitude=0.02)
  shifted, offset = [], 0.004
  federated = FederatedFilter(CAR)
  federated.start(0.0, (0.0, 0.0, 0.2), 2.0)
  for k, stamp in enumerate(trip.time[1:], start=1):
    federated.update(stamp, "speed", trip.truth[k, 2])
    federated.update(stamp, "yaw_rate", trip.truth[k, 5])
    if k % 10 == 0:
      x, y, v, yaw, beta, _ = trip.truth[k]
      course = yaw + beta
      ahead = (x + offset * v * math.cos(course), y + offset * v * math.sin(course), yaw + offset * trip.truth[k, 5])
      for name, value in zip(("pose_x", "pose_y", "pose_yaw"), ahead, strict=True):
        federated.update(stamp + offset, name, value)
    federated.update(stamp, "motor_voltage", trip.commands[k, 0])
    federated.update(stamp, "steering_command", trip.commands[k, 1])
    shifted.append(federated.estimate(stamp))
  errors = [math.hypot(e.pose_x - t[0], e.pose_y - t[1]) for e, t in zip(shifted[300:], trip.truth[301:], strict=True)]
  assert max(errors) < 1e-3


def test_standstill_stays_put_and_grows_no_confidence_out_of_nothing():
  trip = journey(10.0, speed=0.0, amplitude=0.0)
  trip.truth[:, 2:] = trip.truth[0, 2:] * (0, 1, 0, 0)
  trip.accel += 0.05  # an uncalibrated accelerometer
  trip.speed[:] = 0.0
  estimates, _ = run(trip)
  assert all(np.isfinite(last([e])).all() and e.valid for e in estimates)
  speeds = np.abs([e.speed for e in estimates[100:]])
  assert speeds.max() < 0.01
  assert rms(position_errors(trip, estimates)[300:]) < 0.004
  assert min(math.sqrt(e.covariance[0]) for e in estimates) > 5e-4


def test_reverse_and_the_change_of_direction():
  count = 1600
  voltage = np.where(np.arange(count) < 500, hold(0.5), np.where(np.arange(count) < 600, 0.0, hold(-0.4)))
  commands = np.stack([voltage, np.full(count, 0.15)], axis=1)
  trip = journey(16.0, commands=commands)
  assert trip.truth[-1, 2] == pytest.approx(-0.4, abs=1e-3) and trip.truth[-1, 5] < 0.0
  estimates, federated = run(trip)
  errors = position_errors(trip, estimates)
  assert errors[200:].max() < 0.015
  speed = np.array([e.speed for e in estimates]) - trip.truth[:, 2]
  yaw = np.array([e.pose_yaw for e in estimates]) - trip.truth[:, 3]
  assert np.abs(speed[200:]).max() < 0.08 and np.abs(yaw[200:]).max() < 0.03
  assert all(e.valid for e in estimates)


def test_without_a_pose_there_is_no_estimate_but_a_reason():
  federated = FederatedFilter(CAR)
  for k in range(50):
    federated.update(k * PERIOD, "speed", 0.3)
    estimate = federated.estimate(k * PERIOD)
  assert not estimate.valid and estimate.reasons == ("no pose has arrived yet",)
  assert math.isnan(estimate.pose_x) and math.isinf(estimate.std["speed"])


def test_starts_at_the_first_fix_even_when_it_comes_late():
  trip = journey(2.0)
  estimates, _ = run(trip, latency=7)
  assert [e.valid for e in estimates[:7]] == [False] * 7
  assert estimates[7].valid and position_errors(trip, estimates)[7] < 0.03


def test_works_without_accelerometer_and_says_so_by_leaving_the_point_filter_out():
  trip = journey(5.0)
  trip.accel[200:] = np.nan
  estimates, _ = run(trip)
  assert estimates[190].point is not None and estimates[240].point is None
  assert position_errors(trip, estimates)[100:].max() < 0.02


def test_works_without_encoder_and_gyro():
  trip = journey(10.0)
  trip.speed[:], trip.yaw_rate[:] = np.nan, np.nan
  estimates, _ = run(trip)
  assert rms(position_errors(trip, estimates)[300:]) < 0.008


def test_yaw_wraps_nowhere():
  """Three turns on the spot of a pose that is reported in (-pi, pi]."""
  trip = journey(40.0, commands=np.tile([hold(0.5), 0.3], (4000, 1)))
  trip.fix[:, 2] = np.remainder(trip.fix[:, 2] + np.pi, 2 * np.pi) - np.pi
  estimates, federated = run(trip)
  assert trip.truth[-1, 3] > 6 * np.pi
  assert estimates[-1].pose_yaw == pytest.approx(trip.truth[-1, 3], abs=0.02)
  assert not federated.refused


def test_known_biases_are_taken_off():
  settings = FilterSettings(yaw_rate_bias=0.05, accel_x_bias=0.3, accel_y_bias=-0.2)
  trip = journey(8.0)
  plain = last(run(trip)[0])
  trip.yaw_rate += 0.05
  trip.accel += (0.3, -0.2)
  np.testing.assert_allclose(last(run(trip, settings)[0]), plain, atol=1e-9)


def test_motor_speed_is_the_encoder_in_other_units():
  trip = journey(3.0)
  federated = FederatedFilter(CAR)
  update = federated.update

  def in_motor_units(stamp, name, value):
    update(stamp, "motor_speed", value / CAR.rolling_radius) if name == "speed" else update(stamp, name, value)

  federated.update = in_motor_units
  np.testing.assert_allclose(last(run(trip, federated=federated)[0]), last(run(trip)[0]), atol=1e-12)


def test_servo_lag_told_to_the_filter_helps_its_sideslip():
  lag = 0.06
  commands = np.stack([np.full(2000, hold(0.5)), 0.3 * np.sign(np.sin(2.0 * PERIOD * np.arange(2000)))], axis=1)
  actual = commands.copy()
  share = 1.0 - math.exp(-PERIOD / lag)
  angle = 0.0
  for k in range(2000):
    angle += share * (commands[k, 1] - angle)
    actual[k, 1] = angle
  trip = journey(20.0, commands=actual)
  trip.commands = commands

  def sideslip_error(settings):
    return rms(np.array([e.sideslip_angle for e in run(trip, settings)[0]])[300:] - trip.truth[300:, 4])

  assert sideslip_error(FilterSettings(steering_lag=lag)) < 0.3 * sideslip_error(FilterSettings())


def test_unknown_channel_names_the_nearest():
  with pytest.raises(KeyError, match="yaw_rate"):
    FederatedFilter(CAR).update(0.0, "yaw_rat", 1.0)


def test_sharing_factors_outside_zero_to_one_are_refused():
  with pytest.raises(ValueError, match="sharing"):
    FilterSettings(sharing=(0.0, 1.0))


def test_estimates_with_standard_deviations_that_mean_something():
  """Over 20 drives the errors of each estimate have the size the filter states, within 40 %."""
  names = ("pose_yaw", "speed")
  columns = (3, 2)
  ratios = {name: [] for name in names}
  for seed in range(20):
    trip = journey(4.0, seed=seed)
    estimates, _ = run(trip)
    for name, column in zip(names, columns, strict=True):
      ratios[name].append((getattr(estimates[-1], name) - trip.truth[-1, column]) / estimates[-1].std[name])
  for name in names:
    assert 0.3 < rms(ratios[name]) < 1.4, name


@pytest.mark.parametrize("latency", [0, 5])
def test_a_late_fix_makes_the_filter_go_again_over_the_periods_since_its_stamp_and_no_more(latency, monkeypatch):
  """What an update costs, counted in steps of the filter; in microseconds it is in docs/results/estimation.md."""
  trip, federated, steps = journey(5.0), FederatedFilter(CAR), []
  step = LocalFilters.step
  monkeypatch.setattr(LocalFilters, "step", lambda *of: steps.append(1) or step(*of))
  run(trip, latency=latency, federated=federated)
  fixes = np.isfinite(trip.fix[1:, 0]).sum()
  # the first estimate starts at the first fix and passes the periods until now; every later fix goes again
  assert len(steps) == len(trip.time) - 1 + latency * fixes
