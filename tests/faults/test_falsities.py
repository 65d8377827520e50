"""A sample of false logs: none passes as fit, no sound log is refused; all by `python -m tests.faults.falsities`."""

import numpy as np
import pytest

from calibration.log_check import check_log
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from tests.faults.falsities import FALSITIES, SIZES, alarms, outcome, wander
from tests.qcar_twin.recordings.drives import STD, VEHICLE


@pytest.mark.parametrize("number", range(0, len(FALSITIES), 4))
def test_a_false_log_is_not_passed_as_fit(tmp_path, number):
  falsity = FALSITIES[number]
  result, said = outcome(falsity, number, list(SIZES.values())[number % len(SIZES)], tmp_path)
  assert result in ("right", "refused", "warned"), f"{falsity.name}: {said}"


@pytest.mark.parametrize("number", range(1, len(FALSITIES), 6))
def test_a_false_log_under_strange_names_is_not_drafted_as_fit(tmp_path, number):
  falsity = FALSITIES[number]
  result, said = outcome(falsity, number, 1.0, tmp_path, drafted=True)
  assert result in ("right", "refused", "warned"), f"{falsity.name}: {said}"


@pytest.mark.slow
def test_every_false_log_is_not_passed_as_fit(tmp_path):
  passed = [f.name for k, f in enumerate(FALSITIES) if outcome(f, 1000 + k, 1.0, tmp_path)[0] == "passed wrongly"]
  assert not passed


def test_sound_logs_of_every_size_raise_no_alarm():
  assert alarms(4, 7) == []


def numbers(time, columns):
  """Lags, scales and biases that the check gives of a drive."""
  run = Recording.from_columns("run", time, columns)
  check = check_log(DataSet("lab", (run,), VEHICLE, STD))
  return {
    c.motion.name: (c.lag.value, c.scale.value, c.bias.value, c.correlation) for c in check.comparisons if not c.why_not
  }


def turned(columns, angle):
  x, y = columns["pose_x"], columns["pose_y"]
  cos, sin = np.cos(angle), np.sin(angle)
  place = {"pose_x": cos * x - sin * y, "pose_y": sin * x + cos * y}
  return columns | place | {"pose_yaw": columns["pose_yaw"] + angle}


@pytest.mark.parametrize(
  "change",
  [
    lambda t, c: (t + 1000.0, c),
    lambda t, c: (t, c | {"pose_x": c["pose_x"] + 5e5, "pose_y": c["pose_y"] + 5.4e6}),
    lambda t, c: (t, turned(c, 2.0)),
  ],
  ids=["later", "elsewhere", "turned"],
)
def test_where_when_and_in_which_direction_does_not_matter(change):
  time, columns = wander(3)
  before, after = numbers(time, columns), numbers(*change(time, columns))
  assert before.keys() == after.keys() and len(before) == 5
  for name, values in before.items():
    assert after[name] == pytest.approx(values, abs=2e-4), name


def test_a_mirrored_drive_gives_mirrored_numbers():
  time, columns = wander(3)
  across = ("steering_command", "accel_y", "yaw_rate", "pose_y", "pose_yaw")
  before, after = numbers(time, columns), numbers(time, columns | {n: -columns[n] for n in across})
  for name, (lag, scale, bias, correlation) in before.items():
    sign = 1.0 if name in ("driving", "speeding up and slowing down") else -1.0
    assert after[name] == pytest.approx((lag, scale, sign * bias, correlation), abs=1e-6), name


def test_a_stamp_of_the_day_changes_nothing_but_the_origin(tmp_path):
  falsity = next(f for f in FALSITIES if f.name == "time a stamp of the day")
  assert outcome(falsity, 11, 1.0, tmp_path)[0] == "right"
