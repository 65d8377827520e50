"""A drive's command that the car no longer answers: a battery that died, ran low or browned out."""

import re

import numpy as np
import pytest

from calibration.log_check.commands import command_findings
from qcar_twin.recordings.checks.answers import weak_stretches
from qcar_twin.recordings.recording import Recording
from tests.faults.thresholds import FALSE
from tests.faults.wander import wander


def weakened(name: str) -> Recording:
  return Recording.from_columns("run", *FALSE[name][1](*wander(21)))


def test_a_car_that_rolls_out_is_seen_from_where_its_battery_died():
  (lost,) = weak_stretches([weakened("a battery that dies")], "motor_voltage")
  assert 59.0 < lost.start <= 61.5 and lost.end > 88.0


def test_the_seconds_that_are_cut_out_are_all_that_is_wrong():
  run = weakened("a battery that dies")
  (finding,) = command_findings([run])
  assert finding.severity == "spoils" and "a battery that died or browned out" in finding.text
  end = float(re.search(r"ends at to = ([\d.]+)$", finding.text)[1])  # the file ends so, and nothing begins after it
  assert command_findings([run.window(run.start, end)]) == []


def test_brown_outs_are_seen_one_by_one():
  lost = weak_stretches([weakened("a battery that browns out")], "motor_voltage")
  assert len(lost) >= 3 and all(0.25 < s.end - s.start < 2.0 for s in lost)


def test_the_batterys_voltage_is_named_where_it_was_logged():
  time, columns = FALSE["a battery that dies"][1](*wander(21))
  battery = np.where(time < 60.0, 7.6, 5.1)
  (finding,) = command_findings([Recording.from_columns("run", time, columns | {"battery_voltage": battery})])
  assert re.search(r"battery_voltage is 5.1 V from [\d.]+ s to [\d.]+ s, elsewhere 7.6 V", finding.text)


def test_a_duty_of_a_battery_that_runs_low_is_answered():
  """Half the volts at the same duty: what the battery's voltage explains is no weakness."""
  time, columns = wander(22)
  battery = np.interp(time, [0.0, 90.0], [8.4, 3.0])
  columns["motor_duty"] = columns.pop("motor_voltage") / battery
  assert (
    weak_stretches([Recording.from_columns("run", time, columns | {"battery_voltage": battery})], "motor_duty") == []
  )
  assert weak_stretches([Recording.from_columns("run", time, columns)], "motor_duty")


@pytest.mark.parametrize("channel", ["motor_current", "acceleration_command"])
def test_a_command_that_sets_a_force_is_not_judged_by_speed(channel):
  """How fast a car goes says nothing of such a command: turns and slopes take it. Standing is seen."""
  run = weakened("a battery that dies")
  forced = run.replace(streams={channel if n == "motor_voltage" else n: s for n, s in run.streams.items()})
  assert weak_stretches([run], "motor_voltage") and weak_stretches([forced], channel) == []


@pytest.mark.parametrize("seed", range(3))
def test_a_drive_whose_ramp_limits_it_answers(seed):
  """A speed that is commanded in steps and reached at 0.5 m/s^2."""
  random = np.random.default_rng(seed)
  time = np.arange(4000) / 50.0
  asked = np.repeat(random.uniform(0.3, 2.5, 20), 200)
  speed = np.zeros(time.size)
  for k in range(1, time.size):
    speed[k] = speed[k - 1] + np.clip(asked[k] - speed[k - 1], -0.04, 0.01)
  speed += 0.005 * random.standard_normal(time.size)
  run = Recording.from_columns("run", time, {"speed_command": asked, "speed": speed})
  assert weak_stretches([run], "speed_command") == []
