"""Whether a driver steers by what the filter says or by what it has learnt of the filter's errors.

A filter that does not know a bent linkage is off to one side, the more the tighter the turn. A driver that steers by
the estimate holds that at zero, left and right, and the true error is the filter's. One that has learnt
with the filter holds the estimate off, so that the true error is zero, and goes on doing so with a filter that has no
such error.
"""

from collections.abc import Mapping

import numpy as np

from agents.control.interface import Controller
from agents.control.team import Team
from agents.learning.evaluate import EvaluationCase, run_case
from qcar_twin.estimation.settings import ESTIMATED

TURN = 0.5  # 1/m: what is curved by more is a turn, of the paths whose turns are of 1 1/m and more
BEGUN = 3.0  # s, left out: a car comes onto its path
TITLES = ("driver", "filter", "filter's error", "estimated", "true")


def held_rows(drivers: Mapping[str, Controller], path: str, gain: float, offset: float, count: int, seed: int) -> list:
  """Rows of TITLES: mean cross-track errors, mm, in left and right turns on the reduced car with each filter.

  Args:
    gain, offset: of the linkage, - and deg.  count: cars.  seed: of the sensors.
  """
  rows = []
  for name, unknown in (("plain", ()), ("states", ESTIMATED)):
    case = EvaluationCase(path, "reduced", 0.5, gain, offset, count, seed, unknown=unknown)
    driven = run_case(Team(tuple(drivers.values()), count), case)
    for i, label in enumerate(drivers):
      one = driven.cars(slice(i * count, (i + 1) * count))
      zero = np.zeros_like(one.arc_length)
      seen = one.path.errors(one.arc_length, one.pose, np.zeros((*zero.shape, 2)), zero)
      counted = one.under_way & (one.time >= BEGUN)[:, None]
      turns = [counted & (sign * seen.curvature > TURN) for sign in (1.0, -1.0)]
      mean = lambda values, turns=turns: " / ".join(f"{1e3 * values[turn].mean():+.1f}" for turn in turns)
      error = seen.cross_track - one.cross_track
      rows.append((label, name, mean(error), mean(seen.cross_track), mean(one.cross_track)))
  return sorted(rows, key=lambda row: list(drivers).index(row[0]))
