"""With the numbers in use no sound drive is blamed, no false one passed; of several sensors the right one is taken."""

import pytest

from tests.faults.thresholds import acted, drives, errors, several_cases, with_number, wrongly_chosen


@pytest.fixture(scope="module")
def driven():
  return drives(4, 3)


def test_no_sound_drive_is_blamed_and_no_false_one_passed(driven):
  assert errors(*driven) == ([], [])


@pytest.mark.parametrize(("number", "value"), [("_CENTRED", 0.1), ("_LEAP", 0.03), ("_RESTS", 0.005), ("_WEAK", 90.0)])
def test_a_number_far_off_makes_errors(driven, number, value):
  with with_number(acted, number, value):
    alarms, missed = errors(*driven)
  assert alarms or missed


def test_of_several_sensors_the_right_one_is_taken_or_a_person_asked():
  assert wrongly_chosen(several_cases(1, 3)) == []
