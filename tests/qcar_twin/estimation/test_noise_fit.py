"""Process noise from recordings: the likelihood prefers the noise that was there."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.estimation.noise_fit import evidence, fit_noise
from qcar_twin.estimation.offline import filter_recording
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.recordings.recording import RecordingError
from tests.qcar_twin.estimation.estimation_rig import CAR, journey
from tests.qcar_twin.estimation.test_offline import recording_of

LOOSE = dataclasses.replace(FilterSettings(), walk_yaw=0.16, walk_position=0.08)


def test_evidence_prefers_the_model_that_made_the_data():
  """The rig's car has no process noise, so small walks explain it better than large ones and than wrong stiffness."""
  recordings = [recording_of(journey(10.0, seed=3))]
  right, _ = evidence(recordings, CAR, FilterSettings())
  loose, _ = evidence(recordings, CAR, LOOSE)
  wrong, _ = evidence(recordings, dataclasses.replace(CAR, cg_to_front=0.3), FilterSettings())
  assert right > loose + 10.0 and right > wrong


def test_search_finds_its_way_back_from_a_loose_start():
  recordings = [recording_of(journey(4.0, seed=4))]
  fitted = fit_noise(recordings, CAR, LOOSE, rounds=1)
  before, after = (evidence(recordings, CAR, s) for s in (LOOSE, fitted))
  assert after[0] > before[0] + 5.0 and after[1] >= before[1]
  assert fitted.walk_yaw < 0.05 and fitted.walk_position < 0.03
  assert fitted.speed_std == LOOSE.speed_std


def test_evidence_adds_up_over_recordings():
  one, two = (recording_of(journey(3.0, seed=s)) for s in (1, 2))
  both = np.array(evidence([one, two], CAR, FilterSettings()))
  apart = np.add(evidence([one], CAR, FilterSettings()), evidence([two], CAR, FilterSettings()))
  np.testing.assert_allclose(both, apart, rtol=1e-12)


ONBOARD = ("speed", "yaw_rate", "accel_x", "accel_y")


def test_a_fix_counts_once_however_often_its_period_is_passed():
  """Onboard stamps 3 ms after the period's begin arrive when the fix's period has been passed: it is passed again."""
  trip = journey(4.0, seed=5)
  trip.fix[100, 0] += 0.5  # a spike, which is refused
  on_time, apart = recording_of(trip), recording_of(trip, **dict.fromkeys(ONBOARD, 0.003))
  expected, seen = (evidence([r], CAR, FilterSettings()) for r in (on_time, apart))
  assert seen[0] == pytest.approx(expected[0], rel=0.01) and seen[1] == pytest.approx(expected[1], rel=0.01)
  assert filter_recording(apart, CAR).refused["pose", "gate"] == 1


def test_nothing_is_fitted_to_recordings_without_a_pose():
  blind = recording_of(journey(1.0))
  blind = blind.replace(streams={n: s for n, s in blind.streams.items() if not n.startswith("pose")})
  for recordings in ([], [blind]):
    with pytest.raises(RecordingError, match="process noise is fitted to measured poses"):
      fit_noise(recordings, CAR, FilterSettings())
