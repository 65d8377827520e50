"""Shares of an excess: no unit, no quiet sensor and no channel at its floor decides."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.decision.veto import surely_worse
from calibration.diagnosis.holdout_errors import (
  ChannelFit,
  Replay,
  channel_fit,
  held_out_error,
  ratios,
  recovered_share,
  share_removed,
)
from calibration.diagnosis.report.errors import error_table
from calibration.fitting.observations import observe
from tests.calibration.diagnosis.diagnosis_rig import VEHICLE, drive

SIZE = st.floats(1e-6, 1e6)


def fit(before, after, floor, driving=0.0):
  return ChannelFit(before, after, floor, driving, (-1.0, 1.0), "m", 100)


def test_all_of_an_excess_is_one_and_none_of_it_nought():
  before, floor = {"speed": 0.3, "yaw_rate": 0.2}, {"speed": 0.1, "yaw_rate": 0.1}
  assert share_removed(before, floor, floor) == 1.0
  assert share_removed(before, before, floor) == 0.0
  assert share_removed(before, {"speed": 0.6, "yaw_rate": 0.4}, floor) < 0.0


def test_a_channel_that_a_quiet_sensor_watches_counts_like_any_other():
  """Motion capture of a hundredth of a millimetre and a speed of a tenth of a metre per second: half and half."""
  fits = {"pose_forward": fit(0.3, 0.3, 2e-5), "speed": fit(0.4, 0.1, 0.1)}
  assert recovered_share(fits) == pytest.approx((1.0 - 0.0625) / (1.0 + 1.0 - 0.0625), rel=1e-6)


def test_what_the_sensors_make_while_driving_is_no_excess():
  assert recovered_share({"accel_y": fit(0.7, 0.5, 0.05, driving=0.5)}) == 1.0
  assert recovered_share({"accel_y": fit(0.5, 0.5, 0.05, driving=0.5)}) == 0.0


def test_a_channel_at_its_floor_from_the_start_decides_nothing():
  alone, beside = {"speed": fit(0.4, 0.2, 0.1)}, {"yaw_rate": fit(0.1000001, 0.11, 0.1)}
  assert recovered_share(alone | beside) == pytest.approx(recovered_share(alone), abs=0.25)
  assert recovered_share(alone | {"yaw_rate": fit(0.1000001, 0.1, 0.1)}) == pytest.approx(
    recovered_share(alone), abs=1e-5
  )


@given(unit=SIZE)
def test_units_do_not_matter(unit):
  plain = share_removed({"a": 3.0, "b": 2.0}, {"a": 1.0, "b": 1.9}, {"a": 0.5, "b": 1.0})
  scaled = share_removed({"a": 3.0 * unit, "b": 2.0}, {"a": unit, "b": 1.9}, {"a": 0.5 * unit, "b": 1.0})
  assert scaled == pytest.approx(plain)


def test_without_an_excess_there_is_no_share():
  assert share_removed({"a": 1.0}, {"a": 0.5}, {"a": 2.0}) is None
  assert share_removed({"a": 1.0}, {"a": 0.5}, {}) is None


def test_one_block_of_driving_has_no_interval_and_forbids_no_twin():
  """What was driven for three seconds says nothing of how far its error would scatter."""
  observations = observe(drive(1)[:1], VEHICLE)
  one = dataclasses.replace(observations, block=np.zeros_like(observations.block))
  errors, floors = np.stack([np.ones(len(one)), np.full(len(one), 1.1)]), ({}, {})
  found = channel_fit(one, errors, "yaw_rate", floors, np.random.default_rng(0))
  assert found.after == pytest.approx(1.1 * found.before) and np.isnan(found.ci95).all()
  assert surely_worse([held_out_error("holdout", "yaw_rate", found)], usual_levels()) == ()
  row = error_table("", {"yaw_rate": found}).rows[0]
  assert row[-1] is None
  two = channel_fit(observations, errors, "yaw_rate", floors, np.random.default_rng(0))
  assert two.ci95 == pytest.approx((0.1, 0.1)) and len(np.unique(observations.block)) > 1


def test_what_each_name_does_is_told_against_the_twin_without_it():
  observations = observe(drive(1)[:1], VEHICLE)
  left = lambda error: np.full(len(observations), error)
  replay = Replay(observations, left(2.0), left(0.5), {"side_force": left(0.4), "steering_offset": left(2.0)})
  assert ratios(replay) == pytest.approx({"side_force": 1.25, "steering_offset": 0.25}) and ratios(None) == {}
