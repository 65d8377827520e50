"""Which column is the battery's voltage: one that hardly changes, of a size that a small car's battery has."""

import dataclasses

import numpy as np

from qcar_twin.recordings.first_dataset.columns import Columns, Guess

_VOLTS = (2.5, 60.0)  # of a lithium cell that is discharged; protection by extra-low voltage ends there (IEC 61140)


def settle_battery(columns: Columns, guesses: dict[str, Guess]) -> None:
  """A voltage that hardly changes is the battery's, whatever it is called; what no battery of a small car reads is a
  charge in per cent or something else, and stays unused."""
  guess = guesses.get("motor_voltage")
  if guess is not None and "battery_voltage" not in guesses:
    values = columns.values(guess.column)
    if values.min() > 3.0 and np.std(values) < 0.15 * np.mean(values):
      del guesses["motor_voltage"]
      why = [f"a voltage that stays at {np.median(values):.3g} is the battery's"]
      guesses["battery_voltage"] = dataclasses.replace(guess, channel="battery_voltage", why=why)
  if (guess := guesses.get("battery_voltage")) is not None:
    values = guess.scale * columns.values(guess.column)
    read = values[values > 0.0]
    if not read.size or not _VOLTS[0] < float(np.median(read)) < _VOLTS[1]:
      del guesses["battery_voltage"]
