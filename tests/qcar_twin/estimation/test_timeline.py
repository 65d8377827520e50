"""The filter's recent past: where a stamp belongs, what is kept, what a long silence does."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from qcar_twin.estimation.timeline import Clock, Timeline


@given(st.floats(-50.0, 50.0), st.floats(0.0, 100.0))
def test_a_stamp_goes_to_the_nearest_slot_with_the_rest_as_offset(origin, later):
  clock = Clock(0.01)
  assert clock.place(origin) == (0, 0.0)
  index, offset = clock.place(origin + later)
  assert abs(offset) <= 0.005 + 1e-9
  assert clock.time(index) + offset == pytest.approx(origin + later, abs=1e-9)


def test_the_newest_slots_are_kept():
  timeline = Timeline(2, 101)
  first = timeline[0]
  first.motion[1, 0] = 1.0
  for index in range(101):
    assert timeline[index] is timeline[index]
  assert timeline.keeps(0) and timeline[0].motion[1, 0] == 1.0
  _ = timeline[101]
  assert not timeline.keeps(0) and timeline.keeps(1)
  with pytest.raises(IndexError, match="no longer kept; the oldest is 1"):
    _ = timeline[0]


def test_slots_between_are_made_empty():
  timeline = Timeline(2, 200)
  timeline[3].motion[:, 1] = 0.2
  timeline[7].motion[:, 1] = 0.3
  rates = np.stack([timeline[k].motion[:, 1] for k in range(3, 8)])
  np.testing.assert_array_equal(rates, np.array([[0.2] * 2, *[[np.nan] * 2] * 3, [0.3] * 2]))
  assert np.isnan(timeline[5].commands).all() and timeline[5].fix is None and timeline[5].outcome is None


def test_after_a_long_silence_nothing_old_is_carried_along():
  timeline = Timeline(1, 41)
  timeline[0].motion[:] = 1.0
  timeline[10**9].motion[:] = 2.0  # must not make a thousand million slots
  assert timeline[10**9].motion[0, 0] == 2.0 and not timeline.keeps(0)


def test_first_fix_is_the_oldest_complete_one():
  timeline = Timeline(1, 200)
  assert timeline.first_fix() is None
  timeline[2].fix = np.array([[1.0, 2.0, np.nan, 50.0]])
  timeline[5].fix = np.array([[1.0, 2.0, 0.1, np.nan]])
  timeline[8].fix = np.array([[3.0, 2.0, 0.1, 50.0]])
  assert timeline.first_fix() == 5
