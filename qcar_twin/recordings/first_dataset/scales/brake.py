"""A brake that was logged beside the throttle: of a model car both are ends of one command to its speed controller."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.recordings.first_dataset.columns import Columns, Guess
from qcar_twin.recordings.first_dataset.scales.travel import BRAKES
from qcar_twin.recordings.unit_names import unit_of, words_of

PRESSED = 0.05  # of its largest value, from which a brake is pressed
_TOGETHER = 0.02  # share of the pressed rows with throttle as well, up to which one hand gives both
_LONGEST = 1.0  # m of wheelbase: larger cars brake by friction at their wheels, which is no duty
_FULL = 1.05  # of full travel, which a share stays within


def settle_brake(columns: Columns, guesses: Mapping[str, Guess], wheelbase: float) -> None:
  """Take a brake from the duty, `minus`, where both are shares in one unit, never pressed together, of a car of less
  than 1 m of wheelbase: its speed controller brakes by the motor, as by a negative duty."""
  drive = guesses.get("motor_duty")
  if drive is None or drive.offset != 0.0 or drive.gate or wheelbase > _LONGEST:
    return
  brakes = [name for name in columns.names if set(words_of(name)) & BRAKES and not columns.constant(name)]
  if len(brakes) != 1 or brakes[0] == drive.column or unit_of(brakes[0]) != unit_of(drive.column):
    return
  pressed, driven = 0, 0
  for table in columns.holding(brakes[0]):
    if drive.column not in table:
      return
    throttle, brake = (drive.scale * table.number(name, name) for name in (drive.column, brakes[0]))
    if throttle.size != brake.size or np.nanmin(throttle) < 0.0 or np.nanmin(brake) < 0.0 or np.nanmax(brake) > _FULL:
      return
    pressed += int(np.sum(brake > PRESSED))
    driven += int(np.sum((brake > PRESSED) & (throttle > PRESSED)))
  if driven <= _TOGETHER * pressed:
    drive.minus = brakes[0]
    drive.why.append(f"less '{brakes[0]}', never pressed with it: a speed controller brakes by a negative duty")
