"""A duty acts on the battery's voltage where that was logged, and the data set says where it is none of the car's."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from tests.qcar_twin.recordings.drives import VEHICLE, drive, folder_with

RUNNING_DOWN = 8.4 - 0.1 * np.arange(1200) * 0.01  # V


def duties(battery):
  """A drive that puts the same volts on the motor whatever the battery has."""
  time, columns = drive()
  volts = columns.pop("motor_voltage")
  return time, volts, {"motor_duty": volts / battery, **columns, "battery_voltage": battery}


def loaded(tmp_path, battery, supply=8.0):
  time, volts, columns = duties(battery)
  vehicle = {**VEHICLE, "drive": "duty", "supply_voltage": supply}
  return volts, DataSet.load(folder_with(tmp_path, time, columns, vehicle=vehicle))


def test_a_battery_that_runs_down_leaves_the_volts_as_they_were(tmp_path):
  volts, data = loaded(tmp_path, RUNNING_DOWN)
  _, commands = data.recordings[0].commands(0.01, ("motor_duty",), supply=8.0)
  np.testing.assert_allclose(8.0 * commands[:, 0], volts, rtol=1e-9)
  assert not data.warnings


def test_without_a_supply_a_command_is_what_was_logged():
  time, volts, columns = duties(RUNNING_DOWN)
  run = Recording.from_columns("run", time, columns)
  np.testing.assert_array_equal(run.commands(0.01, ("motor_duty",))[1][:, 0], volts / RUNNING_DOWN)


def test_a_slow_reading_is_held_into_a_window():
  time, volts, columns = duties(np.full(1200, 7.5))
  columns["battery_voltage"] = np.where(np.arange(1200) == 0, 7.5, np.nan)
  part = Recording.from_columns("run", time, columns).window(5.0, 8.0)
  at, commands = part.commands(0.01, ("motor_duty",), supply=8.0)
  np.testing.assert_allclose(8.0 * commands[:, 0], np.interp(at, time, volts), rtol=1e-9)


def test_readings_of_zero_are_none():
  battery = np.where(np.arange(1200) < 30, 0.0, 7.5)  # before the first message came
  time, _, columns = duties(np.full(1200, 7.5))
  run = Recording.from_columns("run", time, columns | {"battery_voltage": battery})
  np.testing.assert_allclose(run.commands(0.01, ("motor_duty",), 7.5)[1][:, 0], columns["motor_duty"])
  none = Recording.from_columns("run", time, columns | {"battery_voltage": np.zeros(1200)})
  assert none.battery is None


@pytest.mark.parametrize("supply", [12.0, 5.0])
def test_another_batterys_supply_is_told(tmp_path, supply):
  (said,) = loaded(tmp_path, RUNNING_DOWN, supply)[1].warnings
  assert f"battery_voltage is 7.8 V (median), which is no {supply:g} V battery's" in said
  assert "correct supply_voltage in [vehicle]" in said


def test_a_command_in_volts_takes_nothing_of_the_battery():
  time, columns = drive()
  run = Recording.from_columns("run", time, columns | {"battery_voltage": RUNNING_DOWN})
  np.testing.assert_array_equal(run.commands(0.01, supply=8.0)[1], run.commands(0.01)[1])


def test_a_battery_that_falls_below_its_cut_off_is_told_with_its_seconds(tmp_path, tmp_path_factory):
  battery = np.where(np.arange(1200) < 700, 8.0, 5.0)
  (said,) = (s for s in loaded(tmp_path, battery)[1].warnings if "falls" in s)
  assert "battery_voltage falls to 5 V from 7.00 s to 11.99 s, where it has 8 V at best: empty, or a loose plug" in said
  once = np.where(np.arange(1200) == 700, 5.0, 8.0)  # one reading is none
  assert not [s for s in loaded(tmp_path_factory.mktemp("once"), once)[1].warnings if "falls" in s]


def test_a_battery_that_sags_under_load_is_no_empty_one(tmp_path):
  time, _, columns = duties(np.full(1200, 8.0))
  loaded_ = (time > 7.0) & (time < 7.3)
  columns["battery_voltage"] = np.where(loaded_, 4.9, 8.0)
  columns["motor_duty"] = np.where(loaded_, 0.9, columns["motor_duty"])
  vehicle = {**VEHICLE, "drive": "duty", "supply_voltage": 8.0}
  data = DataSet.load(folder_with(tmp_path, time, columns, vehicle=vehicle))
  (said,) = (s for s in data.warnings if "falls" in s)
  assert "under load, and it recovers at once: a pack of high internal resistance" in said and "empty, or" not in said
