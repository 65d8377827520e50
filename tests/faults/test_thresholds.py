"""With the numbers in use no sound drive is blamed, no false one passed; of several sensors the right one is taken."""

import pytest

from calibration.log_check import causes, disagreements
from tests.faults import disagreeing
from tests.faults.thresholds import acted, answers, drives, driving, errors, neutral, several_cases, wrongly_chosen


@pytest.fixture(scope="module")
def driven():
  return drives(4, 3)


def test_no_sound_drive_is_blamed_and_no_false_one_passed(driven):
  assert errors(*driven) == ([], [])


@pytest.mark.parametrize(
  ("modules", "number", "value"),
  [
    ((neutral,), "_CENTRED", 0.1),
    ((acted,), "_LEAP", 0.03),
    ((driving,), "RESTS", 0.005),
    ((acted, answers), "WEAK", 90.0),
  ],
)
def test_a_number_far_off_makes_errors(driven, modules, number, value):
  with disagreeing.with_number(modules, number, value):
    alarms, missed = errors(*driven)
  assert alarms or missed


@pytest.fixture(scope="module")
def compared():
  """Comparisons of a few sound logs and of falsities that two sensors see."""
  names = ("as it is", "a body that leans", "yaw_rate 0.1 s late")
  return disagreeing.few(5, names, ("speed in knots", "pose_y with the other sign", "yaw_rate in deg/s"))


def test_no_sound_log_is_called_spoilt_by_its_sensors_and_no_false_one_passed(compared):
  assert disagreeing.errors(compared) == ([], [])


def test_a_level_far_off_makes_errors(compared):
  with disagreeing.with_number((causes, disagreements), "KNOTS", 2.5):
    alarms, missed = disagreeing.errors(compared)
  assert alarms or missed


def test_of_several_sensors_the_right_one_is_taken_or_a_person_asked():
  assert wrongly_chosen(several_cases(1, 3)) == []
