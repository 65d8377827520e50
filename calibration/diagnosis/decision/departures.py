"""Figures of the car that the driving contradicts: a servo that is slower than it was measured, a sensor that is late.

Recalibration moves what was measured within its deviation, and further where the driving asks for it. How far it moves
a figure of a car without any effect, since the twin is no more than a model, is known from such cars
(`calibration.intervals.forms`). So

    z = (fitted - measured) / sqrt(s^2 + (f a)^2)

with the deviation s of what was measured and the form deviation f, a share of the figure's size a, is a standard normal
variable where nothing is wrong.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence

from scipy import stats

from calibration.diagnosis.decision.evidence import Measured, Model
from calibration.diagnosis.decision.levels import Levels
from calibration.intervals.forms import OTHERS, usual_forms


@dataclasses.dataclass(frozen=True)
class Departure:
  """A figure that lies farther from what was measured than measuring and the twin's form explain.

  Attributes:
    name: of the parameter.
    value: that the driving asks for; measured, std: what was measured, with its deviation; all in `unit`.
    z: their distance in deviations of measurement and form together.
    usual: nobody measured it, and `measured` and `std` are what is usual of such sensors.
  """

  name: str
  value: float
  measured: float
  std: float
  z: float
  unit: str
  usual: bool = False


def departures(
  figures: Sequence[Measured], levels: Levels, forms: Mapping[str, float] | None = None
) -> tuple[Departure, ...]:
  """Figures beyond the level that any of them passes by chance with probability `conflict`, farthest first.

  Args:
    figures: of the model behind the verdict.
    levels: `conflict` is used.
    forms: form deviation of each figure, as a share of its size, and of "others"; that of forms.toml by default.
  """
  forms = usual_forms() if forms is None else forms
  level = _level(figures, levels)
  found = [_departure(f, forms.get(f.name, forms[OTHERS])) for f in figures]
  return tuple(sorted((d for d in found if abs(d.z) > level), key=lambda d: (-abs(d.z), d.name)))


def needed(departure: Departure, model: Model, levels: Levels) -> bool:
  """Whether the driving asks for a departure: a usual age in its place fits worse, by as much as is beyond chance.

  A fit may leave an age anywhere along a valley, in which others make up for it. A figure that was measured is pulled
  to its measurement, and what pulls it off is the driving.
  """
  rows = [row for row in model.sensors if departure.name in {e.name for e in row.estimates}]
  if not departure.usual or not rows:
    return True
  return math.sqrt(2.0 * max(rows[0].held_out.drop, 0.0)) > _level(model.measured, levels)


def _level(figures: Sequence[Measured], levels: Levels) -> float:
  """Deviations that any of the figures passes by chance with probability `conflict`."""
  return float(stats.norm.isf(levels.conflict / (2.0 * max(len(figures), 1))))


def _departure(figure: Measured, form: float) -> Departure:
  z = (figure.value - figure.measured) / math.hypot(figure.std, form * figure.size)
  return Departure(figure.name, figure.value, figure.measured, figure.std, z, figure.unit, figure.usual)
