"""Form deviations: how far the twin, being a model, moves a figure of a car that has nothing else wrong.

They are measured on cars whose figures are known, by `qcar-twin set-forms`, and stand in `forms.toml` (a discrepancy of
the model beside the error of measurement: Kennedy and O'Hagan, Journal of the Royal Statistical Society B 63, 2001).
"""

import functools
import tomllib
from collections.abc import Mapping
from pathlib import Path

FILE = Path(__file__).with_name("forms.toml")
OTHERS = "others"


def read_forms(file: Path = FILE) -> dict[str, float]:
  """Form deviations by figure, as shares of its size.

  Raises:
    ValueError: an entry has no source, or there is none for figures that are not in it ("others").
  """
  table = tomllib.loads(file.read_text(encoding="utf-8"))
  if OTHERS not in table or not all(entry.get("source") for entry in table.values()):
    raise ValueError(f"{file.name}: every entry needs a source, and one must be called '{OTHERS}'")
  return {name: float(entry["value"]) for name, entry in table.items()}


@functools.cache
def usual_forms() -> Mapping[str, float]:
  """Those of forms.toml."""
  return read_forms()


def size_of(unit: str, stated: float, period: float, cg_height: float) -> float:
  """Of which a figure's form deviation is a share.

  A time's errors are shares of the control period, by which logs and commands are spaced, however short it is; that of
  a distance from what was measured, such as the offset of the centre of gravity's height, of the height itself.

  Args:
    unit: of the figure.
    stated: what was measured, or the usual value, in that unit.
    period: of control, s.
    cg_height: of the car, m.
  """
  return period if unit == "s" else abs(stated) or cg_height
