"""A column named after the battery is its voltage where a battery can read that, and else nothing."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.battery import settle_battery
from qcar_twin.recordings.first_dataset.by_unit import guess_by_unit
from qcar_twin.recordings.first_dataset.columns import Columns, guess_columns
from qcar_twin.recordings.formats import read_table
from tests.qcar_twin.recordings.drives import drive, write_csv


def guessed(tmp_path, name, values):
  time, own = drive(12.0)
  columns = {"throttle": own["motor_voltage"] / 8.0, "speed": 0.003 * own["motor_speed"], name: values}
  columns = Columns((read_table(write_csv(tmp_path / "run.csv", time, columns)),))
  guesses = guess_columns(columns)
  settle_battery(columns, guesses)
  return guesses.get("battery_voltage")


@pytest.mark.parametrize(
  ("name", "full"), [("battery", 100.0), ("battery", 104.0), ("battery_level", 12.0), ("battery_soc", 0.9)]
)
def test_a_charge_is_no_voltage(tmp_path, name, full):
  assert guessed(tmp_path, name, np.linspace(full, 0.8 * full, 1200)) is None


def test_the_only_voltage_is_no_command_where_it_stays(tmp_path):
  """Whatever it is called: the only column in V of a log without a command of the drive."""
  time, own = drive(12.0)
  columns = {"steer": own["steering_command"], "speed": 0.003 * own["motor_speed"], "Pxq [V]": 11.8 - 0.01 * time}
  columns = Columns((read_table(write_csv(tmp_path / "run.csv", time, columns)),))
  guesses = guess_columns(columns)
  guess_by_unit(columns, guesses)
  assert "motor_voltage" not in guesses and guesses["battery_voltage"].column == "Pxq [V]"


@pytest.mark.parametrize(("scale", "full"), [(1.0, 12.6), (1.0, 4.1), (0.001, 12600.0)])
def test_volts_and_millivolts_are(tmp_path, scale, full):
  values = np.linspace(full, 0.9 * full, 1200)
  values[:30] = 0.0  # before its first message
  guess = guessed(tmp_path, "battery", values)
  assert guess is not None and guess.scale == scale
