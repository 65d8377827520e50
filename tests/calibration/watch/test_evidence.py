"""Evidence at any time: nulls rarely alarm, changes soon do, and what driving can't show is left alone."""

import math

import numpy as np
import pytest

from calibration.watch.evidence import BLOCK, LARGEST, RARE, Detector, Null, null_of, sizes_of

CLEAR = Null(0.0, 0.0, 0.0, 1.0)


def alarms(detector, sizes, information):
  count = 0
  for k, size in enumerate(sizes):
    if detector.take(BLOCK * k, size, information):
      count += 1
      detector.reset()
  return count


def test_a_hundred_hours_of_noise_make_less_than_one_alarm_in_ten_hours():
  random = np.random.default_rng(1)
  blocks = int(RARE / BLOCK)
  for information in (2.0, 20.0, 500.0):
    assert alarms(Detector(CLEAR, 1), random.standard_normal(blocks) / math.sqrt(information), information) <= 3


def test_the_null_holds_at_its_edge():
  """As much as the reference showed in its most deceptive driving, lasting for hours, is no alarm."""
  random = np.random.default_rng(2)
  null = Null(0.1, 0.2, 0.0, 1.0)
  sizes = null.reach(10.0) + random.standard_normal(20000) / math.sqrt(10.0)
  assert alarms(Detector(null, 10), sizes, 10.0) == 0


@pytest.mark.parametrize("information", [5.0, 50.0, 5000.0])
def test_a_change_is_seen_within_twenty_seconds_and_dated(information):
  random, delays = np.random.default_rng(3), []
  for _ in range(50):
    detector = Detector(CLEAR, 10)
    for k in range(200):
      size = random.standard_normal() / math.sqrt(information) + (k >= 150)
      if detector.take(BLOCK * k, size, information):
        break
    delays.append(BLOCK * (k + 1 - 150))
    assert abs(detector.since - 300.0) < 30.0 and detector.size == pytest.approx(1.0, abs=0.6)
  assert np.median(delays) <= 20.0 and min(delays) > 0.0


def test_heavy_tails_are_cut():
  random = np.random.default_rng(4)
  assert alarms(Detector(CLEAR, 10), random.standard_t(3, 50000) / math.sqrt(30.0), 10.0) <= 1


def test_driving_that_shows_little_of_it_says_nothing():
  detector = Detector(Null(0.0, 0.1, 4.0, 1.0), 1)
  assert not detector.shown_by(2.0) and detector.null.reach(2.0) > LARGEST
  detector.take(0.0, 5.0, 2.0)
  assert detector.evidence == -math.inf and detector.shown_by(100.0)


def test_nulls_are_learnt_with_what_differs_from_drive_to_drive():
  random = np.random.default_rng(5)
  recording = np.repeat(np.arange(40), 12)
  shift = 0.2 * random.standard_normal(40)
  information = np.full(len(recording), 50.0)
  sizes = shift[recording] + 2.0 * random.standard_normal(len(recording)) / np.sqrt(information)
  more, less = null_of(sizes, information, recording)
  assert more.scatter == pytest.approx(4.0, rel=0.3) and more.between == pytest.approx(0.2, rel=0.4)
  assert more.centre == -less.centre and more.watchable
  assert not null_of(5.0 * shift[recording], information, recording)[0].watchable


def test_what_is_ordinary_is_taken_for_no_change():
  """Generalised least squares: the size is unbiased, and the covariance of what is ordinary is in its information."""
  random = np.random.default_rng(6)
  change, zero = random.standard_normal((2, 80))
  zero = 3.0 * (zero + change)  # looks much like the change
  covariance = np.eye(80) + np.outer(zero, zero)
  for residual in (0.5 * change, zero, 0.5 * change + zero):
    sizes, information = sizes_of(residual, change[None], zero[None])
    weight = change @ np.linalg.inv(covariance)
    assert sizes[0] == pytest.approx(weight @ residual / (weight @ change))
    assert information[0] == pytest.approx(weight @ change)
  plain, _ = sizes_of(zero, change[None], np.empty((0, 80)))
  assert plain[0] > 1.0 and abs(sizes_of(zero, change[None], zero[None])[0][0]) < 0.2


def test_nothing_shown_is_no_size():
  sizes, information = sizes_of(np.ones(5), np.zeros((2, 5)), np.ones((1, 5)))
  assert not sizes.any() and not information.any()
