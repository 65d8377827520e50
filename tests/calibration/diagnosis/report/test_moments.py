"""The moment shown first is where a difference is largest against sensor noise, and no other window beats it."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.report.moments import AROUND, LASTS, largest
from tests.calibration.diagnosis.diagnosis_results import diagnosis_of


@pytest.fixture(scope="module")
def case(offset_pool):
  return diagnosis_of(offset_pool, ("steering_offset",))


def brute(observations, fits, difference):
  """Largest root mean square over all windows of all stretches of the channels that a sensor measures, over noise."""
  best = 0.0
  for channel in ("yaw_rate", "accel_y"):
    for stretch in np.unique(observations.stretch):
      rows = observations.select(channel) & (observations.stretch == stretch)
      time, value = observations.time[rows], difference[rows] / fits[channel].noise
      for start in time[time + LASTS <= time.max() + 1e-9]:
        own = value[(time >= start) & (time <= start + LASTS)]
        best = max(best, float(np.sqrt(np.mean(own**2))))
  return best


def test_no_window_of_two_seconds_holds_more(case):
  replay = case.replay
  found = largest(replay, case.holdout, replay.after - replay.before)
  assert found.size == pytest.approx(brute(replay.observations, case.holdout, replay.after - replay.before))
  assert found.end - found.start == pytest.approx(LASTS, abs=0.05)
  assert found.time[0] >= found.start - AROUND - 1e-9 and found.time[-1] <= found.end + AROUND + 1e-9


def test_a_spike_is_where_it_was_put(case):
  observations = case.replay.observations
  rows = np.flatnonzero(observations.select("yaw_rate"))
  spike, difference = rows[len(rows) // 2], np.zeros(len(observations))
  difference[spike] = 5.0
  found = largest(case.replay, case.holdout, difference)
  assert found.channel == "yaw_rate" and found.start <= observations.time[spike] <= found.end
  assert found.recording == observations.names[observations.recording[spike]]


def test_a_channel_whose_noise_is_unknown_is_not_looked_at(case):
  silent = {n: dataclasses.replace(f, noise_floor=0.0, driving_noise=0.0) for n, f in case.holdout.items()}
  assert largest(case.replay, silent, case.replay.before) is None
  one = {**silent, "accel_y": case.holdout["accel_y"]}
  assert largest(case.replay, one, case.replay.before).channel == "accel_y"
