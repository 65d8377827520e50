"""An engine's speed: a clutch lets it idle while the car stands, and no fixed gear ties it to the wheels."""

from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.checks.driving import LEAST_REST, RESTS
from qcar_twin.recordings.checks.units import Bins
from qcar_twin.recordings.first_dataset.columns import Guess
from qcar_twin.recordings.recording import Recording

_IDLES = 0.05  # of its top speed, stated prior: engines idle at a sixth to a tenth of it, and a geared motor stands
_MOST = (
  0.9  # share of the time at rest in which it turns: one that hums to a stop, or that a hand turned, does at times
)


def leave_engine(guesses: dict[str, Guess], recordings: Sequence[Recording]) -> None:
  """Leave out a motor's speed that idles while the car stands, where another sensor has the car's speed."""
  if not {"motor_speed", "speed"} <= guesses.keys():
    return
  turns = [(bins.mean("motor_speed"), bins.mean("speed"), bins.edges) for bins in map(Bins, recordings)]
  if not turns:
    return
  motor, speed = (np.abs(np.concatenate([row[k] for row in turns])) for k in (0, 1))
  both = np.isfinite(motor) & np.isfinite(speed)
  if not both.any():
    return
  motor, speed, period = motor[both], speed[both], float(turns[0][2][1] - turns[0][2][0])
  idle = motor[speed <= RESTS * np.percentile(speed, 99.0)] > _IDLES * np.percentile(motor, 99.0)
  if idle.size * period >= LEAST_REST and idle.mean() >= _MOST:
    engine = guesses.pop("motor_speed")
    guesses["speed"].why.append(f"'{engine.column}' is left out: it turns while the car stands, as an engine does")
