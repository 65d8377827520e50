"""The five classes of faults online: errors inside stated bounds, sensors named, recovery; and sound drives."""

import math

import numpy as np
import pytest

from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.watches.monitor import SpeedWatch, StampWatch
from tests.qcar_twin.estimation.estimation_rig import CAR, PERIOD, hold, journey, position_errors, run

BEGIN, END = 800, 1300  # periods


def swinging(seconds=20.0, seed=0):
  """Speeds between about 0.3 and 0.7 m/s: a frozen encoder is wrong."""
  time = PERIOD * np.arange(round(seconds / PERIOD))
  voltage = [hold(0.5 + 0.3 * math.sin(t)) for t in time]
  return journey(seconds, seed=seed, commands=np.stack([voltage, 0.25 * np.sin(0.9 * time)], axis=1))


def beyond(trip, estimates):
  """Share of the valid instants, from 2 s on, at which position or yaw are beyond their bounds."""
  place = position_errors(trip, estimates)
  turned = np.abs([e.pose_yaw - t[3] for e, t in zip(estimates, trip.truth, strict=True)])
  bounds = np.array([e.bounds for e in estimates])
  wrong = (place > bounds[:, 0]) | (turned > bounds[:, 1])
  return float((wrong & [e.valid for e in estimates])[200:].mean())


@pytest.mark.parametrize("seed", range(5))
def test_sound_sensors_are_never_accused(seed):
  trip = swinging(30.0, seed)
  estimates, federated = run(trip)
  assert not any(e.warnings for e in estimates[1:]) and federated.refused.total() <= 1
  assert beyond(trip, estimates) < 0.005


def test_bounds_are_there_from_the_first_pose_on():
  federated = FederatedFilter(CAR)
  assert federated.estimate(0.0).bounds == (math.inf, math.inf)
  estimates, _ = run(journey(4.0))
  place, angle = estimates[-1].bounds
  assert 0.005 < place < 0.05 and 0.01 < angle < 0.3


def test_lidar_lost_for_five_seconds():
  trip = swinging()
  trip.fix[BEGIN:END] = np.nan
  estimates, _ = run(trip)
  errors = position_errors(trip, estimates)
  assert errors[BEGIN:END].max() < 0.1 and errors[END + 50 :].max() < 0.02
  assert beyond(trip, estimates) < 0.005


@pytest.mark.parametrize("bias", [0.1, -0.1, 0.3])
def test_a_gyro_bias_is_found_and_taken_off(bias):
  trip = swinging()
  trip.yaw_rate[BEGIN:] += bias
  estimates, _ = run(trip)
  turned = np.abs([e.pose_yaw - t[3] for e, t in zip(estimates, trip.truth, strict=True)])
  assert position_errors(trip, estimates)[BEGIN:].max() < 0.06
  assert turned[BEGIN:].max() < 0.7 * abs(bias) and turned[BEGIN + 300 :].max() < 0.03
  assert not estimates[BEGIN - 1].warnings and "the gyro is taken to be off by" in estimates[BEGIN + 200].warnings[0]
  assert float(estimates[-1].warnings[0].split()[-2]) == pytest.approx(bias, abs=0.02)
  assert beyond(trip, estimates) < (0.005 if abs(bias) < 0.2 else 0.03)  # a large one turns the car before it is found


@pytest.mark.parametrize("kind", ["frozen", "zero"])
def test_a_stuck_encoder_is_left_out_and_taken_back(kind):
  trip = swinging()
  trip.speed[BEGIN:END] = trip.speed[BEGIN - 1] if kind == "frozen" else 0.0
  estimates, _ = run(trip)
  accused = np.array([bool(e.warnings) for e in estimates])
  assert accused[BEGIN + 10 : END].all() and not accused[1:BEGIN].any() and not accused[END + 150 :].any()
  assert position_errors(trip, estimates)[BEGIN:].max() < 0.04
  assert beyond(trip, estimates) < 0.005


def test_a_latency_that_the_stamps_do_not_say_is_read_off_their_beat():
  trip = swinging()
  late = np.full_like(trip.fix, np.nan)
  late[BEGIN + 5 : END + 5] = trip.fix[BEGIN:END]
  trip.fix[BEGIN : END + 5] = late[BEGIN : END + 5]
  trip.fix[END : END + 5] = late[END : END + 5]
  estimates, federated = run(trip)
  assert position_errors(trip, estimates)[BEGIN:].max() < 0.025
  assert "taken to be 50 ms older" in estimates[END - 1].warnings[0]
  assert not estimates[BEGIN - 1].warnings and not estimates[-1].warnings
  assert federated.refused["pose", "off the beat"] >= 4
  assert beyond(trip, estimates) < 0.005


def test_spikes_in_all_sensors_at_once():
  trip = swinging()
  rng = np.random.default_rng(0)
  hit = lambda chance: (rng.random(END - BEGIN) < chance) * rng.choice((-1.0, 1.0), END - BEGIN)
  trip.fix[BEGIN:END, 0] += 0.5 * hit(0.3)
  trip.yaw_rate[BEGIN:END] += hit(0.05)
  trip.speed[BEGIN:END] += 0.5 * hit(0.05)
  estimates, _ = run(trip)
  assert position_errors(trip, estimates)[BEGIN:].max() < 0.03
  assert beyond(trip, estimates) < 0.005


# -- the watches alone ---------------------------------------------------------------------------


def heard(samples):
  """When a watch calls an encoder frozen that said this."""
  watch, verdicts = SpeedWatch(), []
  for sample in samples:
    watch.hear(sample)
    verdicts.append(watch.frozen)
  return np.array(verdicts)


def test_a_fine_encoder_is_frozen_after_few_samples_and_a_coarse_one_after_many():
  rng = np.random.default_rng(0)
  fine = 0.5 + 0.01 * rng.standard_normal(500)
  coarse = np.round(fine / 0.02) * 0.02
  for samples, few, many in ((fine, 2, 6), (coarse, 10, 40)):
    assert not heard(samples).any()
    when = np.argmax(heard([*samples, *[samples[-1]] * 100])) - len(samples)
    assert few <= when <= many
  assert not heard(np.zeros(500)).any()  # at rest


def test_a_sudden_stop_that_the_accelerometer_feels_is_no_fault_of_the_encoder():
  watch = SpeedWatch()
  watch.judge(0.5, 0.0, 0.15, True)
  for k in range(5):
    watch.coast(-10.0, PERIOD)
    assert watch.supported(0.5 - 0.1 * (k + 1), 0.15)
  still = SpeedWatch()
  still.judge(0.5, 0.0, 0.15, True)
  still.coast(0.0, PERIOD)
  assert not still.supported(0.0, 0.15) and not SpeedWatch().supported(0.0, 0.15)


def stamps_of(delays, jitter=0.0, lost=()):
  """Stamps of a lidar of 10 Hz with the delays they do not say, s."""
  rng = np.random.default_rng(0)
  stamps = 0.1 * np.arange(len(delays)) + delays + jitter * rng.standard_normal(len(delays))
  return np.delete(stamps, lost)


def test_a_beat_that_jumps_tells_the_delay_and_lost_fixes_do_not():
  delays = np.zeros(100)
  delays[40:70] = 0.06
  watch, used, said = StampWatch(), [], []
  for stamp in stamps_of(delays, jitter=0.002, lost=(20, 21, 50, 90)):
    used.append(watch.hear(stamp))
    said.append(watch.delay)
  assert used.count(False) == 4 and said[60] == pytest.approx(0.06, abs=0.01) and abs(said[-1]) < 0.01


def test_stamps_without_a_beat_are_taken_as_they_are():
  rng = np.random.default_rng(1)
  watch = StampWatch()
  assert all(watch.hear(stamp) for stamp in np.cumsum(rng.uniform(0.02, 0.18, 200))) and watch.delay == 0.0
