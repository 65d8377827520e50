"""A drive's command that the car no longer answers: a battery that died, ran low or browned out."""

import re

import numpy as np
import pytest

from calibration.log_check.commands import command_findings
from qcar_twin.recordings.checks.acted import lost_sign
from qcar_twin.recordings.checks.answers import (
  braked_stretches,
  command_per_speed,
  unanswered_stretches,
  weak_stretches,
)
from qcar_twin.recordings.checks.faults import find_defects
from qcar_twin.recordings.recording import Recording, Stream
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


def test_a_controller_that_brakes_first_is_named_with_every_stretch():
  run = weakened("a controller that brakes first")
  braked = braked_stretches([run], "motor_voltage")
  assert [s.start for s in braked] == pytest.approx([50.5 + 8.0 * k for k in range(5)], abs=0.15)
  assert [s.end for s in braked] == pytest.approx([51.2 + 8.0 * k for k in range(5)], abs=0.15)
  (said,) = command_findings([run])
  assert "a usual ESC brakes at the first press and reverses at the second" in said.text
  assert said.text.count(" s to ") == 5 and "log the ESC's state" in said.text


def test_a_car_that_reverses_at_once_and_is_held_is_no_controller_that_brakes():
  """The same stands, but where it drives backwards it does so under a first press."""
  run = weakened("a controller that brakes first")
  command = run["motor_voltage"]
  first = np.where((command.value == 0.0) & (command.time > 51.0), 0.5, command.value)  # forwards between the presses
  assert (
    braked_stretches(
      [run.replace(streams={**run.streams, "motor_voltage": Stream(command.time, first)})], "motor_voltage"
    )
    == []
  )


def test_a_car_that_stands_under_a_command_stands_whatever_the_sign_of_its_noise():
  time, columns = wander(21)
  still = (time > 60.0) & (time < 61.6)
  noise = np.where(np.arange(time.size) // 12 % 2, 0.02, -0.02)  # of means of a quarter of a second
  columns |= {
    "speed": np.where(still, noise, columns["speed"]),
    "motor_voltage": np.where(still, 6.0, columns["motor_voltage"]),
  }
  (lost,) = weak_stretches([Recording.from_columns("run", time, columns)], "motor_voltage")
  assert lost.start < 60.8 and lost.end > 61.3


def throttled(seed: int, per_speed: float, per_change: float, brakes: float, friction: float = 0.04) -> Recording:
  """A drive by command = friction + per_speed v + per_change v', `brakes` in the latter's place where it slows down,
  under a throttle that drops to less than half every 6 s."""
  random, time = np.random.default_rng(seed), np.arange(4500) / 50.0
  level = np.where(np.arange(45) % 3, random.uniform(0.5, 0.8, 45), random.uniform(0.25, 0.4, 45))
  command, speed = np.repeat(level, 100), np.zeros(time.size)
  for k in range(1, time.size):
    pull = command[k] - friction - per_speed * speed[k - 1]
    speed[k] = max(speed[k - 1] + 0.02 * pull / (per_change if pull > 0.0 else brakes), 0.0)
  noisy = speed + 0.01 * random.standard_normal(time.size)
  return Recording.from_columns(f"run_{seed}", time, {"motor_duty": command, "speed": noisy})


@pytest.mark.parametrize("seed", range(4))
def test_a_car_that_slows_down_to_what_its_command_keeps_answers(seed):
  """It is faster meanwhile than its command keeps it, though it slows down more than is usual beside another car."""
  pair = [throttled(seed, 0.25, 0.155, 0.155), throttled(50 + seed, 0.172, 0.173, 0.173)]
  assert weak_stretches(pair, "motor_duty") == []
  assert weak_stretches([throttled(2, 0.25, 0.4, 0.1)], "motor_duty") == []


def test_what_a_car_takes_to_go_faster_is_told_with_its_deviation():
  time, columns = wander(21)
  (value, std) = command_per_speed([Recording.from_columns("run", time, columns)], "motor_voltage") or (0.0, 0.0)
  assert value == pytest.approx(4.0, abs=max(3.0 * std, 0.02)) and std < 0.1
  level = columns | {"motor_voltage": np.full(time.size, 4.0)}
  assert command_per_speed([Recording.from_columns("run", time, level)], "motor_voltage") is None


def stopping(seed: int = 3) -> tuple[np.ndarray, dict[str, np.ndarray]]:
  """Drives of 6 s, a level each and then a duty backwards that stops the car and holds it."""
  random, time = np.random.default_rng(seed), np.arange(4500) / 50.0
  told = np.where(time % 6.0 < 4.0, np.repeat(random.uniform(0.2, 0.8, 15), 300), -0.5)
  speed = np.zeros(time.size)
  for k in range(1, time.size):
    pull = told[k] - 0.04 - 0.2 * speed[k - 1] if told[k] > 0.0 else -0.6
    speed[k] = max(speed[k - 1] + 0.02 * pull / 0.1, 0.0)
  return time, {"motor_duty": told, "speed": speed}


def test_a_controller_that_brakes_holds_what_it_has_stopped():
  """The twin's controller does so, too; a motor that is given the voltage itself would go backwards."""
  time, columns = stopping()
  held = Recording.from_columns("run", time, columns)
  assert unanswered_stretches([held], "motor_duty") == [] and command_findings([held]) == []
  assert not any("frozen" in note for note in find_defects(held))
  columns["motor_voltage"] = columns.pop("motor_duty")
  assert unanswered_stretches([Recording.from_columns("run", time, columns)], "motor_voltage")


def test_a_car_that_stands_and_is_then_told_backwards_is_not_braked():
  time, columns = stopping()
  late = (time % 6.0 >= 4.0) & (time % 6.0 < 5.0)
  columns["motor_duty"] = np.where(late, 0.0, columns["motor_duty"])  # it rolls out meanwhile
  columns["speed"] = np.where(time % 6.0 >= 4.8, 0.0, columns["speed"])
  columns["motor_duty"] = np.where(time > 60.0, columns["motor_duty"].clip(None, -0.5), columns["motor_duty"])
  columns["speed"] = np.where(time > 60.0, 0.0, columns["speed"])
  assert unanswered_stretches([Recording.from_columns("run", time, columns)], "motor_duty")


@pytest.mark.parametrize("reverses", [False, True])
def test_a_duty_backwards_that_never_drove_a_car_backwards_brakes_it_at_rest_too(reverses):
  """Told neutral in between, one with a reverse would set off."""
  time, columns = stopping()
  again = (time % 6.0 >= 5.0) & (time % 6.0 < 5.8) & (time < 84.0)  # after the stop, and the next start follows
  columns["motor_duty"] = np.where(again, -0.4, np.where(time % 6.0 >= 4.8, 0.0, columns["motor_duty"]))
  columns["speed"] = np.where(time % 6.0 >= 4.8, 0.0, columns["speed"])
  columns["speed"] = np.where(again & (time < 12.0) & reverses, -1.0, columns["speed"])
  idle = unanswered_stretches([Recording.from_columns("run", time, columns)], "motor_duty")
  assert bool(idle) is reverses


def test_a_car_that_goes_slower_round_circles_under_more_of_a_command_answers():
  random, time = np.random.default_rng(5), np.arange(12000) / 50.0
  circles = time > 12.0
  turning = np.where(circles & (time % 20.0 < 16.0), 1.6, 0.0)
  told = np.where(circles, np.where(turning > 0.0, 0.21, 0.2), np.repeat(random.uniform(0.1, 0.3, 40), 300))
  speed = np.zeros(time.size)
  for k in range(1, time.size):
    pull = told[k] - 0.013 - 0.046 * speed[k - 1] - 0.0005 * (speed[k - 1] * turning[k]) ** 2
    speed[k] = max(speed[k - 1] + 0.02 * pull / 0.045, 0.0)
  noisy = speed + 0.005 * random.standard_normal(time.size)
  run = Recording.from_columns("run", time, {"motor_duty": told, "speed": noisy, "yaw_rate": turning})
  assert weak_stretches([run], "motor_duty") == []


def test_a_speed_that_stuck_before_a_pause_drives_nothing_backwards():
  time, columns = stopping()
  stuck = (time > 60.0) & (time < 77.5)
  columns["speed"] = np.where(stuck, 2.81, columns["speed"])
  later = time + np.where(time >= 77.5, 30.0, 0.0)
  assert lost_sign([Recording.from_columns("run", later, columns)], "motor_duty") == []
