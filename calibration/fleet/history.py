"""A fleet's page: parameters and verdicts by car and day, spread against stated error, and who is odd."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from calibration.fleet.hierarchy import LEVEL, Comparison, Reading, Spread, compare, spreads
from qcar_twin.pages import Section, Table, write_page
from qcar_twin.pages.charts import Chart

Lines = Sequence[Mapping[str, Any]]
_LISTED = 20  # comparisons on the page
_WORDS = {"fit": "fit", "beware": "fit, with warnings", "refused": "refused"}


def readings_of(lines: Lines) -> list[Reading]:
  """Parameters of the logs that have any with a deviation."""
  made = []
  for line in lines:
    values = {n: (p["value"], p["std"]) for n, p in line.get("parameters", {}).items() if p["std"] and p["std"] > 0.0}
    if values:
      made.append(Reading(line["car"], line["day"], values))
  return made


def summary(lines: Lines, compared: Sequence[Comparison]) -> str:
  """The fleet in a sentence or two."""
  states = Counter(line["state"] for line in lines)
  cars, days = len({line["car"] for line in lines}), len({line["day"] for line in lines})
  text = f"{len(lines)} logs of {cars} cars on {days} days: " + ", ".join(
    f"{states[state]} {_WORDS[state]}" for state in _WORDS if states[state]
  )
  if accused := [c for c in compared if c.accused]:
    return f"{text}. Odd: {accused[0].sentence}." + (f" And {len(accused) - 1} more." if len(accused) > 1 else "")
  return f"{text}. " + ("No car and no day is odd." if compared else "Too few cars and days to compare.")


def write_history(lines: Lines, path: Path) -> tuple[Path, list[Comparison]]:
  """Write the page; returns its path and every comparison, the least likely first."""
  readings = readings_of(lines)
  compared = compare(readings)
  sections = [_odd(compared), _states(lines)]
  if readings:
    sections += [_spread(spreads(readings)), _parameters(lines)]
  page = write_page(path, "History of the fleet", summary(lines, compared), sections)
  return page, compared


def _odd(compared: Sequence[Comparison]) -> Section:
  text = (
    "A car, or a day, is compared with all others on every parameter. The scatter of the others decides, where it is"
    f" more than they state. The chance of accusing any of equal ones is {100.0 * LEVEL:.0f} % over all comparisons"
    " of a kind (Holm), where the stated deviations are right."
  )
  titles = ("kind", "which", "parameter", "value", "the others", "difference", "its deviation", "chance", "odd")
  rows = [
    (c.kind, c.unit, c.parameter, c.value, c.others, c.difference, c.std, c.chance, "odd" if c.accused else "")
    for c in sorted(compared, key=lambda c: c.chance)[:_LISTED]
  ]
  tables = [Table("The least likely first", titles, rows)] if rows else []
  return Section("Outliers", text, tables)


def _states(lines: Lines) -> Section:
  titles = ("log", "car", "day", "driven [s]", "state", "what it says", "diagnosis")
  rows = []
  for line in lines:
    told = line.get("diagnosis")
    claims = ", ".join(c["mechanism"] for c in told["claims"]) if told else ""
    verdict = f"{told['verdict']}{': ' if claims else ''}{claims}" if told else ""
    state = _WORDS[line["state"]]
    rows.append((line["log"], line["car"], line["day"], line.get("driven"), state, line["verdict"], verdict))
  return Section("Logs", "", [Table("Every log", titles, rows)])


def _spread(made: Sequence[Spread]) -> Section:
  titles = ("parameter", "logs", "mean", "stated deviation", "scatter", "of which between logs")
  rows = [(s.parameter, s.logs, s.mean, s.stated, s.scatter, s.between) for s in made]
  text = "Where logs scatter more than they state, they differ, or their deviations are too small."
  return Section("Spread against stated error", text, [Table("", titles, rows, unfolded=True)])


def _parameters(lines: Lines) -> Section:
  names = sorted({n for line in lines for n in line.get("parameters", {})})
  return Section("Parameters by car and day", "", figures=[_chart(name, lines) for name in names])


def _chart(name: str, lines: Lines) -> Chart:
  """One parameter over the days, one trace a car."""
  rows = sorted((line for line in lines if name in line.get("parameters", {})), key=lambda line: line["day"])
  traces = []
  for car in sorted({line["car"] for line in rows}):
    own = [(line["day"], line["parameters"][name]) for line in rows if line["car"] == car]
    error = {"type": "data", "array": [p["std"] for _, p in own]}
    points = {"x": [day for day, _ in own], "y": [p["value"] for _, p in own], "error_y": error}
    traces.append({"type": "scatter", "mode": "markers", "name": car, **points})
  unit = rows[0]["parameters"][name]["unit"]
  layout = {"xaxis": {"title": {"text": "day"}, "type": "category"}, "yaxis": {"title": {"text": f"{name} [{unit}]"}}}
  return Chart(f"{name}, one standard deviation", traces, layout)
