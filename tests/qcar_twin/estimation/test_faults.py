"""Faults the filter must survive, each with numbers: errors in metres, verdicts, counts."""

import math

import numpy as np
import pytest

from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.estimation.watches.monitor import SpeedWatch
from tests.qcar_twin.estimation.estimation_rig import CAR, PERIOD, hold, journey, position_errors, rms, run

FIXES = slice(0, None, 10)


def healthy_rms(seconds=20.0):
  trip = journey(seconds)
  return rms(position_errors(trip, run(trip)[0])[300:])


def test_lidar_spikes_of_half_a_metre_do_not_show():
  """One fix in ten jumps by 0.5 m in a random direction with a good score: all are refused, 2 cm at most remain."""
  trip = journey(30.0)
  rng = np.random.default_rng(4)
  rows = np.arange(50, len(trip.time), 10)
  hit = rows[rng.random(len(rows)) < 0.1]
  angle = rng.uniform(0, 2 * np.pi, len(hit))
  trip.fix[hit, 0] += 0.5 * np.cos(angle)
  trip.fix[hit, 1] += 0.5 * np.sin(angle)
  estimates, federated = run(trip)
  errors = position_errors(trip, estimates)
  assert len(hit) > 15 and federated.refused["pose", "gate"] == len(hit)
  assert errors[100:].max() < 0.02 and rms(errors[300:]) < 1.3 * healthy_rms(30.0)
  assert all(e.valid for e in estimates)


def test_yaw_spikes_do_not_show():
  trip = journey(15.0)
  trip.fix[500:1500:100, 2] += 0.6
  estimates, federated = run(trip)
  assert federated.refused["pose", "gate"] == 10
  assert np.abs(np.array([e.pose_yaw for e in estimates]) - trip.truth[:, 3])[100:].max() < 0.02


def test_lidar_gone_for_three_seconds():
  """Dead reckoning on model, encoder and gyro: 5 cm at most, inside three of its own standard deviations; a
  fix brings it back."""
  trip = journey(20.0)
  trip.fix[800:1100] = np.nan
  estimates, _ = run(trip)
  errors = position_errors(trip, estimates)
  assert errors[800:1100].max() < 0.05 and errors[1150:].max() < 0.02
  spread = np.array([math.sqrt(e.covariance[0] + e.covariance[2]) for e in estimates])
  assert np.all(errors[800:1100] < 3.0 * spread[800:1100])
  assert spread[1095] > 3.0 * spread[795]
  assert all(e.valid for e in estimates)


def test_lidar_gone_for_good_ends_validity():
  trip = journey(20.0)
  trip.fix[800:] = np.nan
  estimates, _ = run(trip)
  assert estimates[1200].valid and not estimates[1350].valid
  assert "no accepted pose for" in " ".join(estimates[1350].reasons)
  assert np.isfinite([estimates[-1].pose_x, estimates[-1].covariance[0]]).all()


def test_encoder_stuck_at_zero_under_way():
  """The gate refuses it at once; lidar and motor model carry on within 3 cm, and the fault is named."""
  trip = journey(20.0)
  trip.speed[800:] = 0.0
  estimates, federated = run(trip)
  errors = position_errors(trip, estimates)
  speeds = np.array([e.speed for e in estimates[800:]])
  assert errors[800:].max() < 0.03
  assert np.abs(speeds - 0.5).max() < 0.1
  assert federated.refused["speed", "gate"] <= 3  # then it is left out
  doubted = [bool(e.warnings) for e in estimates]
  assert not any(doubted[1:800]) and all(doubted[810:]) and "encoder contradicts" in estimates[-1].warnings[0]
  assert all(e.valid for e in estimates)


def test_encoder_stuck_at_zero_from_the_start():
  """The harder case: the car pulls away from rest while the encoder keeps agreeing that it stands."""
  count = 2000
  commands = np.stack([np.where(np.arange(count) < 100, 0.0, hold(0.5)), np.zeros(count)], axis=1)
  trip = journey(20.0, speed=0.0, commands=commands)
  assert trip.truth[-1, 2] == pytest.approx(0.5, abs=0.01)
  trip.speed[:] = 0.0
  estimates, _ = run(trip)
  errors = position_errors(trip, estimates)
  bad = np.array([not e.valid for e in estimates])
  assert errors[600:].max() < 0.03 and abs(estimates[-1].speed - 0.5) < 0.1
  assert bad[errors > 0.1].mean() > 0.5  # while it is led astray it mostly knows
  assert estimates[-1].valid and "encoder contradicts" in estimates[-1].warnings[0]


def test_encoder_is_believed_again_after_it_recovers():
  trip = journey(30.0)
  trip.speed[800:1500] = 0.0
  estimates, _ = run(trip)
  assert estimates[1490].warnings and not estimates[-1].warnings
  assert estimates[-1].std["speed"] < 0.5 * estimates[1490].std["speed"]


def test_accelerometer_bias_jump_of_one_metre_per_second_squared():
  """EKF_PM is pulled away; the master stays within 3 cm because EKF_BM and the fixes do not."""
  trip = journey(20.0)
  trip.accel[800:] += (1.0, -1.0)
  estimates, _ = run(trip)
  assert position_errors(trip, estimates)[800:].max() < 0.03


def test_accelerometer_gone_wild_restarts_the_point_filter():
  trip = journey(20.0)
  trip.accel[800:] += (8.0, 0.0)
  estimates, federated = run(trip)
  assert federated.refused["pose", "gate of the point filter"] > 10
  assert position_errors(trip, estimates)[800:].max() < 0.06


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_gyro_not_a_number(value):
  """Refused and counted, every one; the yaw rate comes from model and lidar, nothing becomes NaN."""
  trip = journey(15.0)
  federated = FederatedFilter(CAR)
  estimates = []
  for k, stamp in enumerate(trip.time):
    federated.update(stamp, "speed", trip.speed[k])
    federated.update(stamp, "yaw_rate", value if k > 500 else trip.yaw_rate[k])
    for name, sample in zip(("pose_x", "pose_y", "pose_yaw"), trip.fix[k], strict=False):
      if math.isfinite(sample):
        federated.update(stamp, name, sample)
    estimates.append(federated.estimate(stamp))
    federated.update(stamp, "motor_voltage", trip.commands[k, 0])
    federated.update(stamp, "steering_command", trip.commands[k, 1])
  assert federated.refused["yaw_rate", "not finite"] == len(trip.time) - 501
  turning = np.array([e.yaw_rate for e in estimates]) - trip.truth[:, 5]
  assert np.abs(turning[520:]).max() < 0.1
  assert position_errors(trip, estimates)[100:].max() < 0.02 and estimates[-1].valid


def test_gyro_spikes_are_refused():
  trip = journey(10.0)
  trip.yaw_rate[500::37] += 3.0
  estimates, federated = run(trip)
  assert federated.refused["yaw_rate", "gate"] == len(trip.yaw_rate[500::37])
  assert np.abs(np.array([e.yaw_rate for e in estimates]) - trip.truth[:, 5])[100:].max() < 0.1


def test_a_car_carried_elsewhere_is_found_again_after_half_a_second():
  trip = journey(15.0)
  trip.fix[800:, :2] += (1.0, -0.7)
  trip.truth[800:, :2] += (1.0, -0.7)
  estimates, federated = run(trip)
  errors = position_errors(trip, estimates)
  assert not estimates[830].valid and "contradict" in " ".join(estimates[830].reasons)
  assert errors[860:].max() < 0.03 and estimates[900].valid
  assert federated.refused["pose", "gate"] == FilterSettings().lost_after


def test_strays_at_one_place_in_a_row_are_no_new_place_where_strays_are_frequent():
  """A third of the fixes lies half a metre off, seven of them in a row; the car is where the others say."""
  trip = journey(20.0)
  rows = np.arange(600, 1300, 10)
  chosen = np.random.default_rng(2).random(len(rows)) < 0.3
  chosen[27:40] = [False] * 3 + [True] * 7 + [False] * 3
  trip.fix[rows[chosen], 0] -= 0.5
  estimates, _ = run(trip)
  assert position_errors(trip, estimates)[600:].max() < 0.04
  assert not estimates[960].valid and estimates[1400].valid


def test_a_lost_car_is_found_again_although_a_third_of_the_fixes_are_strays():
  trip = journey(25.0)
  trip.fix[800:, :2] += (1.0, -0.7)
  trip.truth[800:, :2] += (1.0, -0.7)
  rng = np.random.default_rng(3)
  rows = np.arange(500, 2500, 10)
  rows = rows[rng.random(len(rows)) < 0.3]
  trip.fix[rows, :2] += rng.uniform(-3.0, 3.0, (len(rows), 2))
  estimates, _ = run(trip)
  errors = position_errors(trip, estimates)
  assert errors[1500:].max() < 0.04
  assert not any(e.valid for e, error in zip(estimates[850:], errors[850:], strict=True) if error > 0.3)


def test_a_lidar_gone_mad_is_not_followed():
  """Fixes anywhere within 3 m for two seconds agree with nothing, so they never count as a new place."""
  trip = journey(15.0)
  rng = np.random.default_rng(5)
  rows = np.arange(800, 1000, 10)
  trip.fix[rows, :2] += rng.uniform(-3, 3, (len(rows), 2))
  estimates, _ = run(trip)
  assert position_errors(trip, estimates)[800:1000].max() < 0.04
  assert not estimates[950].valid and estimates[1100].valid


def test_duplicated_and_out_of_order_stamps_together():
  """Every sample twice, every tenth one held back by up to 0.3 s: the estimate is that of an orderly stream."""
  trip = journey(8.0)
  expected = run(trip)[0][-1]
  federated, rng, pending = FederatedFilter(CAR), np.random.default_rng(6), []
  for k, stamp in enumerate(trip.time):
    samples = [("speed", trip.speed[k]), ("yaw_rate", trip.yaw_rate[k])]
    samples += [("accel_x", trip.accel[k, 0]), ("accel_y", trip.accel[k, 1])]
    samples += [
      (n, v) for n, v in zip(("pose_x", "pose_y", "pose_yaw", "pose_score"), trip.fix[k], strict=True) if np.isfinite(v)
    ]
    for name, value in samples:
      held = rng.uniform(0.0, 0.3) if rng.random() < 0.1 and 0 < k < len(trip.time) - 40 else 0.0
      pending += [(stamp + held, stamp, name, value)] * 2
    now = [p for p in pending if p[0] <= stamp + 1e-9]
    pending = [p for p in pending if p[0] > stamp + 1e-9]
    for _, when, name, value in now:
      federated.update(when, name, value)
    estimate = federated.estimate(stamp)
    federated.update(stamp, "motor_voltage", trip.commands[k, 0])
    federated.update(stamp, "steering_command", trip.commands[k, 1])
  assert (estimate.pose_x, estimate.pose_y) == pytest.approx((expected.pose_x, expected.pose_y), abs=1e-12)
  repeated = sum(n for (_, reason), n in federated.refused.items() if reason == "repeated")
  assert repeated >= 4 * len(trip.time)


def test_position_known_too_badly_is_said():
  trip = journey(5.0)
  estimates, _ = run(trip, FilterSettings(position_limit=0.001))
  assert not estimates[-1].valid and "position known to 0.00 m only" in estimates[-1].reasons


# -- the encoder's watch -------------------------------------------------------------------------


def watch_of(speed, said, std=0.008, seed=0, jump=0.0):
  watch, rng = SpeedWatch(), np.random.default_rng(seed)
  x = 0.0
  verdicts = []
  for k in range(100):
    for _ in range(10):
      watch.travel(said, PERIOD)
    x += 0.1 * speed + (jump if k == 50 else 0.0)
    watch.compare(0.1 * k, x + std * rng.normal(), std * rng.normal(), std)
    verdicts.append(watch.doubted)
  return verdicts


@pytest.mark.parametrize("speed", [0.0, 0.1, 0.5, 2.0])
def test_honest_encoders_are_never_doubted(speed):
  assert not any(any(watch_of(speed, 1.05 * speed, seed=seed)) for seed in range(20))


def test_bad_fixes_do_not_make_the_encoder_suspect():
  assert not any(any(watch_of(0.3, 0.3, std=0.05, seed=seed)) for seed in range(20))


@pytest.mark.parametrize(("speed", "said"), [(0.5, 0.0), (0.5, 1.2), (0.0, 0.6)])
def test_stuck_and_spinning_encoders_are_found_within_two_seconds(speed, said):
  assert all(watch_of(speed, said, seed=seed)[20] for seed in range(10))


def test_one_jump_of_the_position_is_not_the_encoders_fault():
  assert not any(watch_of(0.5, 0.5, jump=2.0))
