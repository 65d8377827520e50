"""The filter's recent past: where a stamp belongs, what is kept, what a long silence does."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from qcar_twin.estimation.timeline import Slot, Timeline


@given(st.floats(-50.0, 50.0), st.floats(0.0, 100.0))
def test_a_stamp_goes_to_the_nearest_slot_with_the_rest_as_offset(origin, later):
  timeline = Timeline(0.01, 1.0)
  assert timeline.place(origin) == (0, 0.0)
  index, offset = timeline.place(origin + later)
  assert abs(offset) <= 0.005 + 1e-9
  assert timeline.time(index) + offset == pytest.approx(origin + later, abs=1e-9)


def test_slots_are_kept_for_twice_the_buffer():
  timeline = Timeline(0.01, 0.5)
  timeline.place(0.0)
  first = timeline[0]
  first.speed = 1.0
  for index in range(101):
    assert timeline[index] is timeline[index]
  assert timeline.keeps(0) and timeline[0].speed == 1.0
  _ = timeline[101]
  assert not timeline.keeps(0) and timeline.keeps(1)
  with pytest.raises(IndexError, match="no longer kept; the oldest is 1"):
    _ = timeline[0]


def test_slots_between_are_made_empty():
  timeline = Timeline(0.01, 1.0)
  timeline[3].yaw_rate = 0.2
  timeline[7].yaw_rate = 0.3
  assert [timeline[k].yaw_rate for k in range(3, 8)] == [0.2, None, None, None, 0.3]
  assert timeline[5] == Slot()


def test_after_a_long_silence_nothing_old_is_carried_along():
  timeline = Timeline(0.01, 0.2)
  timeline[0].speed = 1.0
  timeline[10**9].speed = 2.0  # must not make a thousand million slots
  assert timeline[10**9].speed == 2.0 and not timeline.keeps(0)


def test_first_fix_is_the_oldest_complete_one():
  timeline = Timeline(0.01, 1.0)
  assert timeline.first_fix() is None
  timeline[2].pose = {"pose_x": 1.0, "pose_y": 2.0}
  timeline[5].pose = {"pose_x": 1.0, "pose_y": 2.0, "pose_yaw": 0.1, "pose_score": 50.0}
  timeline[8].pose = {"pose_x": 3.0, "pose_y": 2.0, "pose_yaw": 0.1}
  assert timeline.first_fix() == 5
