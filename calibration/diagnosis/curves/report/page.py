"""The page of free curves: what departs, the curves with their names, what stands beside them, and what it gains."""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration.diagnosis.curves.naming.forms import LEVEL, Outline
from calibration.diagnosis.curves.naming.refits import MATERIAL
from calibration.diagnosis.curves.naming.terms import Term
from calibration.diagnosis.curves.report import wording
from calibration.diagnosis.curves.report.shapes import BAND, Shape, View, shapes
from calibration.diagnosis.curves.study import Study
from calibration.diagnosis.holdout_errors import ratio
from calibration.diagnosis.report.wording import listed
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.pages import Cell, Chart, Section, Table, bars, line, panels, write_page
from qcar_twin.pages.charts import Trace, packed
from qcar_twin.pages.page import Tone
from qcar_twin.twin.mechanisms import catalogue

REPORT = "report.html"
_RIVALS = (("dash", "good"), ("dashdot", "before"), ("longdash", "partly"), ("dash", "note"))  # forms beside the name
_SWATCH, _LETTER, _WIDE, _LINE = 60, 7, 900, 20  # pixels of a legend's entry, of its letters, of a line of entries
_SMALLEST = 1e-4  # probability that is written out
_READABLE = {"s": ("ms", 1e3), "rad": ("°", float(np.degrees(1.0)))}
_KINDS = {  # of twins, as tables and charts call them
  "base": "base",
  "diagnosed": "after the diagnosis",
  "curves": "all maps free",
  "characterised": "characterised",
  "named": "named forms only",
  "black_box": "black box on base",
  "black_box_on_characterised": "black box on characterised",
  "noise": "noise",
}
_BARS = {"before": "diagnosed", "twin": "characterised", "bicycle": "named", "nominal": "black_box", "noise": "noise"}

Errors = Mapping[str, Mapping[str, float]]


def write_study(found: Study, folder: str | os.PathLike[str]) -> Path:
  """Write report.html; returns its path."""
  drawn = shapes(found.found, found.outlines)
  observations = found.found.fitted.problem.observations
  seconds = float(observations.stretches.segments.steps.sum()) * observations.stretches.segments.period
  subtitle = f"{len(observations.names)} recordings, {seconds:.0f} s of driving, {len(observations)} measured values"
  return write_page(
    Path(folder) / REPORT,
    f"Free curves of {found.dataset}",
    wording.verdict(found, drawn),
    [*sections(found, drawn), checked(found)],
    subtitle,
    facts(found, drawn),
    tone(found),
  )


def tone(found: Study) -> Tone:
  """The colour beside the verdict: whether there is something, and whether modelling it helps."""
  if not any(o.is_there for o in found.outlines):
    return "plain"
  before, after, _ = wording.compared(found)
  return "good" if found.gain >= 0.0 and ratio(after, before) < 1.0 else "partly"


def facts(found: Study, drawn: Sequence[Shape]) -> list[tuple[str, str]]:
  """The numbers that go with the verdict."""
  there = [s.part for o, s in zip(found.outlines, drawn, strict=True) if o.is_there]
  rows = [("Departs from the base laws", listed(there) or "nothing")]
  for name, kinds in (("hold-out", found.errors), ("validation", found.judged)):
    if kinds:
      change = 100.0 * (ratio(kinds["characterised"], kinds["base"]) - 1.0)
      rows.append((f"Errors characterised, {name}", f"{change:+.0f} %".replace("-", "−")))
  return [*rows, ("twin.toml is", _KINDS[found.best])]


def sections(found: Study, drawn: Sequence[Shape], diagnosed: Errors | None = None, before: str = "") -> list[Section]:
  """What a page says of the curves, in reading order.

  Args:
    found: what was studied; drawn: its curves.
    diagnosed: errors by "holdout" and "validate", then channel, of the twin that a diagnosis repaired.
    before: put before the titles, on a page that has others.
  """
  made = [_curves(found, drawn), *([_sessions(found)] if _of_sessions(found) else []), _beside(found)]
  made.append(_errors(found, diagnosed or {}))
  return [Section(f"{before}{s.title}", s.text, s.tables, s.figures) for s in made]


def checked(found: Study) -> Section:
  """What the check of the data set said."""
  title = "Warnings about the data set"
  if not found.notes:
    return Section(title, "There are none.")
  text = "These are the warnings of the data set's check, and what was done about each."
  return Section(title, text, [Table("Remarks", ("remark",), [(note,) for note in found.notes])])


def _curves(found: Study, drawn: Sequence[Shape]) -> Section:
  text = (
    "Dotted is the base car's law, with the gains, dampings and frictions that come nearest. Blue is what these"
    " recordings show; its band holds the truth in 95 % of cars, place by place. Whether a curve departs is judged over"
    " all of it at once, in the table below. Forms of the catalogue that may be the curve lie over it: its name, the"
    " simplest that is not refused, is drawn through, the others are dashed."
  )
  for outline, shape in zip(found.outlines, drawn, strict=True):
    said = wording.departure(outline, shape) if outline.is_there else f"{shape.part.capitalize()}: no departure shows."
    text += f"\n* {said} {wording.form_words(outline)}".rstrip()
  tables = [_verdicts(found.outlines), *([_forms(found)] if any(o.told for o in found.outlines) else [])]
  return Section("The maps", text, tables, [curve_chart(shape) for shape in drawn])


def _verdicts(outlines: Sequence[Outline]) -> Table:
  rows: list[tuple[Cell, ...]] = []
  for o in outlines:
    unnamed = f"nearly {listed(o.nearly.mechanisms)}" if o.nearly else "none known" if o.is_there else "–"
    name = listed(o.named.mechanisms) if o.named else unnamed
    others = ", ".join(" and ".join(f.mechanisms) for f in o.possible[1:]) or "–"
    rows.append(
      (o.curve, o.is_there, f"{o.departs:.2g}" if o.departs >= _SMALLEST else f"< {_SMALLEST:g}", name, others)
    )
  title = f"how often chance makes as much (departs below {LEVEL:g})"
  return Table("Curves and names", ("curve", "departs", title, "name", "fits as well"), rows)


def _forms(found: Study) -> Table:
  """Sizes of the names: as fitted in the curves' place one by one, and with everything else at the end."""
  parameters, values = found.told.fitted.fit.parameters, found.told.fitted.fit.theta
  std = np.sqrt(np.maximum(np.diag(found.told.covariance), 0.0))
  held = found.told.fitted.fit.at_bound  # a bound leaves no deviation to be told
  fitted = {name: (float(values[i]), None if held[i] else float(std[i])) for i, name in enumerate(parameters.names)}
  unit = {p.name: p.unit for mechanism in catalogue().values() for p in mechanism.parameters}
  rows: list[tuple[Cell, ...]] = []
  for outline, form in ((o, o.told) for o in found.outlines if o.told):
    for name, value in form.values.items():
      rows.append((outline.curve, name, value, form.std[name], *fitted.get(name, (None, None)), unit[name]))
  columns = ("curve", "parameter", "in its place", "± std", "with all else", "± std ", "unit")
  return Table("Sizes of the named forms", columns, rows)


def curve_chart(shape: Shape) -> Chart:
  """A curve and its departure from the base car's law, with bands and forms."""
  parts: list[tuple[str, str, list[Trace]]] = []
  for whole in (True, False):
    for view in shape.views:
      heading = f"{shape.part.capitalize()} {view.heading}".strip() if whole else "departure from the law"
      parts.append((heading, shape.y_title if whole else f"departure [{shape.y_unit}]", _traces(view, whole)))
  count = len(shape.views) if len(shape.views) > 1 else 2
  caption = f"{shape.part.capitalize()} where it was driven, and its departure from the base car's law."
  chart = panels(caption, parts, shape.x_title, columns=count, height=250)
  names = {str(trace["name"]) for trace in chart.traces}
  lines = sum(_SWATCH + _LETTER * len(name) for name in names) // _WIDE
  layout = {**chart.layout, "margin": {**chart.layout["margin"], "t": 64 + _LINE * lines}}
  return dataclasses.replace(chart, layout=layout, height=chart.height + _LINE * lines)


def _traces(view: View, whole: bool) -> list[Trace]:
  law = view.law if whole else np.zeros(len(view.x))
  curve, wide = law + view.departure, BAND * view.std
  band = {
    "type": "scatter", "mode": "lines", "fill": "toself", "fillcolor": "@twin/0.2", "line": {"width": 0},
    "name": "its 95 % band", "legendgroup": "band", "hoverinfo": "skip",
    "x": packed(np.concatenate([view.x, view.x[::-1]])),
    "y": packed(np.concatenate([curve + wide, (curve - wide)[::-1]])),
  }  # fmt: skip
  tip = {"hovertemplate": "%{x:.3g}: %{y:.3g}"}
  traces: list[Trace] = [band, line(view.x, law, "nominal", "base law", style={"dash": "dot"}, **tip)]
  traces.append(line(view.x, curve, "twin", "free curve", **tip))
  for number, (name, departure) in enumerate(list(view.forms.items())[: 1 + len(_RIVALS)]):
    dash, who = ("solid", "bicycle") if number == 0 else _RIVALS[number - 1]
    traces.append(line(view.x, law + departure, who, name, style={"dash": dash}, **tip))
  return traces


def _of_sessions(found: Study) -> list[Term]:
  return [t for t in found.terms if "@" in t.name]


def _sessions(found: Study) -> Section:
  """Trims and gains of the sessions, a row each."""
  twin, terms = found.found.twin, {t.name: t for t in found.terms}
  gain, values = twin.vehicle.motor.gain, twin.parameters.named(found.found.theta)
  scaled = {gain: (100.0 / values[gain], "%")} | {
    n: _readable(twin.parameters[n].unit) for n in twin.sessions.std if n != gain
  }
  columns, rows = ["session"], []
  for name in twin.sessions.std:
    unit = scaled[name][1]
    columns += [f"{'drive gain' if name == gain else 'steering trim'} [{unit}]", f"± std [{unit}]", "stands out"]
  for session in twin.sessions.names:
    row: list[Cell] = [session]
    for name, (factor, _) in ((n, scaled[n]) for n in twin.sessions.std):
      term = terms.get(f"{name}@{session}")  # what sessions do as well without is not in the twin
      row += [factor * term.value, factor * term.std, term.there] if term else [None, None, False]
    rows.append(row)
  text = (
    "Each session has its own trim of the steering and gain of the drive, as departures from the mean of all sessions."
    " A servo's horn slips, a pack is fuller. They are left out of twin.toml, which is the mean car."
  )
  return Section("The sessions", text, [Table("Sessions against their mean", columns, rows)])


def _readable(unit: str) -> tuple[float, str]:
  name, factor = _READABLE.get(unit, (unit, 1.0))
  return factor, name


def _beside(found: Study) -> Section:
  rows: list[tuple[Cell, ...]] = []
  held = dict(zip(found.told.fitted.fit.parameters.names, found.told.fitted.fit.at_bound.tolist(), strict=True))
  declared = {p.name: p for mechanism in catalogue().values() for p in mechanism.parameters}
  for term in sorted((t for t in found.terms if "@" not in t.name), key=lambda t: -abs(t.value) / max(t.std, 1e-12)):
    factor, unit = _readable(term.unit)
    said = declared[term.name].description or term.name.replace("_", " ")
    bound = held.get(term.name, False)
    out = "at its bound" if bound else "yes" if term.there else "no"
    lost = None if term.error_without is None else 100.0 * (term.error_without - 1.0)
    rows.append((term.name, said, factor * term.value, None if bound else factor * term.std, unit, lost, out))
  text = (
    "What would bend the curves if it were left out was freed with them: ages of sensors and actuators in ms, scales,"
    f" the loss of turning. A value stands out where a twin refitted without it errs by {100 * MATERIAL:.0f} % more at"
    f" least, beyond what chance makes in {100 * LEVEL:.0f} % of cars. What the twin does as well without is left out"
    " of it and stands here as it was fitted before. Ages count from the youngest sensor."
  )
  columns = ("parameter", "what it is", "value", "± std", "unit", "error without it [%]", "stands out")
  return Section(
    "Parameters fitted with the curves",
    text,
    [Table("Parameters fitted with the curves", columns, rows)] if rows else [],
  )


def _errors(found: Study, diagnosed: Errors) -> Section:
  if not (found.errors or found.judged):
    return Section("What it gains", "There are no held-out and no validation recordings, so no error can be shown.")
  text = (
    "Errors are root mean squares of free runs from measured starts, in each channel's unit, by MuJoCo. Base is today's"
    " twin, recalibrated. All maps free has a curve for every map. Characterised has names where they will do and"
    " curves where none will. Named forms only has the best name everywhere. The black box is boosted trees on the"
    " base's residual, or on the characterised twin's, which may use what no law of a car does. Noise is the sensors'"
    " own while driving. Validation errors are of twins that had not seen these recordings. All twins were then"
    " fitted to them as well, and are reported, written and driven on the hold-out like that."
  )
  if diagnosed:
    text += " This base was recalibrated for the curves, and so differs from the one the diagnosis began with."
  roles = (
    ("holdout", "Held-out recordings, opened at the end", found.errors),
    ("validate", "Validation recordings, which decide what is written", found.judged),
  )
  repaired = lambda role: {"diagnosed": diagnosed[role]} if diagnosed.get(role) else {}
  kinds = {role: (caption, {**errors, **repaired(role)}) for role, caption, errors in roles if errors}
  tables = [_error_table(caption, errors) for caption, errors in kinds.values()]
  return Section("What it gains", text, tables, [_error_chart(kinds["holdout"][1])] if found.errors else [])


def _error_table(caption: str, errors: Errors) -> Table:
  present = [kind for kind in _KINDS if kind in errors]
  rows: list[list[Cell]] = []
  for channel in errors["base"]:
    values: list[Cell] = [errors[kind].get(channel) for kind in present]
    change = 100.0 * (errors["characterised"][channel] / errors["base"][channel] - 1.0)
    rows.append([RESIDUALS[channel].words, RESIDUALS[channel].symbol, *values, f"{change:+.1f}".replace("-", "−")])
  return Table(caption, ("channel", "unit", *(_KINDS[k] for k in present), "characterised / base [%]"), rows)


def _error_chart(errors: Errors) -> Chart:
  """Errors of every kind in shares of the base's."""
  base = errors["base"]
  channels = [name for name in base if base[name] > 0.0]
  share = lambda kind: [errors[kind].get(name, np.nan) / base[name] for name in channels]
  values = {who: share(kind) for who, kind in _BARS.items() if kind in errors}
  caption = "Errors on held-out recordings, as shares of those of the base twin: below the line is better."
  names = [RESIDUALS[name].words for name in channels]
  labels = {who: _KINDS[kind] for who, kind in _BARS.items()}
  return bars(caption, names, values, "error / error of the base", level=(1.0, "base"), labels=labels)
