"""Does the battery's voltage that duties are shares of belong to the car that is described?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.recordings.recording import Recording

_SPAN = 4.2 / 3.0  # V of a lithium cell, charged and at its cut-off: no battery reads further from its usual


def supply_notes(recordings: Sequence[Recording], vehicle: Mapping[str, float | str]) -> list[str]:
  """What to know before a result is trusted: a supply that isn't the battery's, and files in which it stands for it."""
  driven = [r for r in recordings if r.drive_channel == "motor_duty" and "motor_duty" in r]
  without = [r for r in driven if r.battery is None]
  usual = float(np.median(np.concatenate([r.battery.value for r in driven if r.battery is not None] or [[np.nan]])))
  notes = []
  stated = float(vehicle.get("supply_voltage", np.nan))
  if max(usual / stated, stated / usual) > _SPAN:
    notes.append(
      f"battery_voltage is {usual:.3g} V (median), which is no {stated:.3g} V battery's, full or empty; duties act on "
      "what was logged; correct supply_voltage in [vehicle], or scale battery_voltage in [channels]"
    )
  if len(without) < len(driven):
    notes += [f"{r.file or r.name}: has no battery_voltage; supply_voltage stands for it" for r in without]
  return notes
