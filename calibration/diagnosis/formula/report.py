"""The formula in the report: a sentence, the picture of force against variable with the data in it, errors."""

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.formula.after import TWIN, Shipped
from calibration.diagnosis.formula.columns import said
from calibration.diagnosis.formula.finding import Found
from calibration.diagnosis.formula.moments import by_pulse
from calibration.diagnosis.formula.words import sentence, variables
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.pages import Cell, Chart, Section, Table
from qcar_twin.pages.charts import axis
from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.variables import VARIABLES, spell

Array = NDArray[np.float64]

_POINTS = 1500  # of the recovered force that are drawn


def formula_sections(shipped: Shipped | None) -> list[Section]:
  """One section where something is unexplained; none elsewhere."""
  if shipped is None:
    return []
  found, text = shipped.rest, sentence(shipped.rest, shipped.change if shipped.holdout else None)
  tables, drawn = [], []
  if found.kind and found.twin:
    rows: list[tuple[Cell, ...]] = [
      (p.name, f"{v:.4g} ± {s:.2g} {p.unit}", p.description) for p, v, s in found.twin.values
    ]
    tables.append(Table("Its numbers", ("parameter", "value ± standard deviation", "meaning"), rows))
    if shipped.holdout:
      tables.append(_errors(shipped))
    if shipped.kept:
      text += f"\n\nIt is a file to read, change and keep: {found.twin.mechanism.name}.py; {TWIN} is the twin with it."
    else:
      text += "\n\nNothing is written: on held-out recordings the errors grow with it."
    picture = force_chart(found)
    drawn += [picture] if picture else []
  return [Section("A formula for what has no name", text, tables, drawn)]


def force_chart(found: Found) -> Chart | None:
  """Recovered force against the variable it follows most, and what the formula or table says at the same moments."""
  names = variables(found)
  if found.sought is None or found.twin is None or not names:
    return None
  driven, force = found.sought.driven, found.sought.recovered
  degree, name = DEGREES[force.degree], names[0]
  x = by_pulse(driven.values[name], driven.period).reshape(-1)
  seen = force.std.reshape(-1) > 0.0
  smooth = force.force.reshape(-1) * found.sought.responses.scale
  told = by_pulse(said_by(found), driven.period).reshape(-1)
  order = np.flatnonzero(seen)
  order = order[:: max(1, len(order) // _POINTS)]
  unit = spell(VARIABLES[name].unit)
  points = lambda y, who, size: {"type": "scatter", "mode": "markers", "x": x[order].tolist(), "y": y[order].tolist(),
                                 "name": who, "marker": {"size": size, "opacity": 0.6}}  # fmt: skip
  layout = {"xaxis": axis(f"{VARIABLES[name].words} [{unit}]"), "yaxis": axis(f"{degree.symbol} [{degree.unit}]")}
  caption = (
    f"{degree.words.capitalize()} recovered from what the twin leaves over, over pulses of 50 ms, and what the"
    f" {found.kind} says at the same moments."
  )
  return Chart(caption, [points(smooth, "recovered", 4), points(told, found.kind, 3)], layout, 420)


def said_by(found: Found) -> Array:
  """The formula at every control period, (S, T)."""
  assert found.sought and found.twin
  return said(found.twin.mechanism, [value for _, value, _ in found.twin.values], found.sought.driven)


def _errors(shipped: Shipped) -> Table:
  rows: list[tuple[Cell, ...]] = [
    (RESIDUALS[name].axis, fit.before, fit.after, round(100.0 * fit.ci95[0], 1), round(100.0 * fit.ci95[1], 1))
    for name, fit in shipped.holdout.items()
  ]
  columns = ("channel", "repaired twin", "with it", "change, lower 95 % [%]", "change, upper 95 % [%]")
  return Table("Errors on held-out recordings", columns, rows)
