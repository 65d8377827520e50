"""The page of a cross-validation: errors of twin and bicycle by window and channel, where they part, runs overlaid."""

import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from calibration.checking.cross_validation import CrossValidation, Replay, ordered
from calibration.checking.free_run import CHANNELS as OVAL_CHANNELS
from calibration.checking.free_run import PUBLISHED
from calibration.checking.model_difference import Cell, ModelDifference
from calibration.fitting.observations import UNITS
from calibration.reports.page import Picture, Section, Table, picture, write_page
from qcar_twin.atomic_io import write_json
from qcar_twin.plotting import BEFORE, bars, draw, house, new_figure

_OVERLAYS = 5  # recordings that are drawn
_DRAWN = ("motor_speed", "speed", "yaw_rate", "accel_y")
_POINTS = 4000  # of a line


def write_cross_validation(result: CrossValidation, folder: str | os.PathLike[str]) -> Path:
  """Write cross_validation.json and report.html; returns the report's path."""
  folder = Path(folder)
  write_json(folder / "cross_validation.json", result.document())
  driven = sum(r.duration for r in result.dataset.recordings if r.role in result.roles)
  names = result.replays[0].observations.names
  subtitle = f"Data set {result.dataset.name}, role {', '.join(result.roles)}: {len(names)} recordings, {driven:.0f} s"
  return write_page(folder / "report.html", "Cross-validation of the twin", verdict(result), sections(result), subtitle)


def verdict(result: CrossValidation) -> str:
  """The outcome in one sentence."""
  window = result.replays[-1]
  twin = window.scores("twin")
  where = "free runs" if math.isinf(window.window) else f"windows of {window.name}"
  told = ", ".join(f"{_plain(c)} {twin[c].rmse:.2g} {UNITS[c]}" for c in _headline(list(twin)))
  text = f"In {where} the twin errs by {told}"
  if result.reference is None:
    return f"{text}; there is no bicycle to compare with."
  bicycle = window.scores("bicycle")
  better = sum(twin[c].rmse < bicycle[c].rmse for c in twin)
  return (
    f"{text} (root mean square); it is nearer to the recordings than the bicycle on {better} of {len(twin)} channels."
  )


def sections(result: CrossValidation) -> list[Section]:
  """Everything the page shows, in reading order."""
  parts = [_errors(result)]
  if result.difference:
    parts.append(_parting(result.difference))
  if result.ovals:
    parts.append(_ovals(result))
  parts += [_runs(result), _by_recording(result), _models(result)]
  return parts


def _errors(result: CrossValidation) -> Section:
  text = (
    "Windows are started anew from the measured speed, yaw rate and pose; a free run is started once and never "
    "corrected."
    " RMSE in the channel's unit. NRMSE is RMSE over the standard deviation of what was measured: 0 is perfect, 1 no"
    " better than the mean. Displacements of the pose are over 1 s, over 0.4 s in windows of 0.5 s."
  )
  tables = [Table(_capital(r.name), _titles(result), _rows(result, r)) for r in result.replays]
  return Section("Errors by window and channel", text, tables, [_bars(result)])


def _titles(result: CrossValidation) -> tuple[str, ...]:
  rmse = tuple(f"RMSE {m}" for m in result.models)
  return ("channel", *rmse, "sensor noise", *(f"NRMSE {m}" for m in result.models), "samples")


def _rows(result: CrossValidation, replay: Replay, recording: int | None = None) -> list[tuple]:
  scores = {m: replay.scores(m, recording) for m in result.models}
  rows = []
  for c in ordered(list(scores["twin"])):
    own = [scores[m][c] for m in result.models]
    noise = result.noise.get(c)
    title = f"{_plain(c)} [{UNITS[c]}]"
    rows.append((title, *(s.rmse for s in own), noise, *(s.nrmse for s in own), own[0].samples))
  return rows


@house()
def _bars(result: CrossValidation) -> Picture:
  figure, axes = new_figure(1, len(result.replays), row_height=2.6)
  for panel, replay in zip(axes[0], result.replays, strict=True):
    scores = {m: replay.scores(m) for m in result.models}
    channels = ordered(list(scores["twin"]))
    bars(panel, [_plain(c) for c in channels], {m: [s[c].nrmse for c in channels] for m, s in scores.items()})
    panel.set_title(replay.name, loc="left")
    if panel.get_ylim()[1] > 0.6:
      panel.axhline(1.0, color=BEFORE, linewidth=0.8)
  axes[0, 0].set_ylabel("NRMSE")
  axes[0, 0].legend()
  return picture(figure, "NRMSE by channel: 0 is perfect, 1 no better than the mean.")


def _parting(difference: ModelDifference) -> Section:
  told = difference.sentences()
  text = (
    "Root mean square difference of twin and bicycle in windows of 2 s, by measured speed and lateral acceleration "
    "(v r),"
    " beside each one's error there.\n\n"
  )
  text += "\n".join(f"* {line}." for line in told) or "They differ by less than 5 % of what is measured everywhere."
  titles = (
    "channel",
    "region",
    "measured",
    "difference",
    "of measured [%]",
    "error of twin",
    "error of bicycle",
    "samples",
  )
  tables = [
    Table("By lateral acceleration", titles, [_cell(c, c.lateral, "m/s²") for c in difference.by_lateral]),
    Table("By speed", titles, [_cell(c, c.speed, "m/s") for c in difference.by_speed]),
  ]
  return Section("Where the two models part", text, tables, _maps(difference))


def _cell(cell: Cell, edge: tuple[float, float], unit: str) -> tuple:
  low, high = edge
  region = f"above {low:g} {unit}" if math.isinf(high) else f"{low:g} to {high:g} {unit}"
  name = f"{_plain(cell.channel)} [{UNITS[cell.channel]}]"
  return name, region, cell.size, cell.difference, 100.0 * cell.share, cell.twin, cell.bicycle, cell.samples


@house()
def _maps(difference: ModelDifference) -> list[Picture]:
  channels = [c for c in ("yaw_rate", "accel_y") if any(cell.channel == c for cell in difference.grid)]
  if not channels:
    return []
  figure, axes = new_figure(1, len(channels), row_height=2.8)
  for panel, channel in zip(axes[0], channels, strict=True):
    _map(panel, [c for c in difference.grid if c.channel == channel])
    panel.set_title(f"{_plain(channel)} [%]", loc="left")
    panel.set_xlabel("speed [m/s]")
    panel.set_ylabel("lateral acceleration [m/s$^2$]")
  return [
    picture(
      figure,
      (
        "Difference of twin and bicycle in per cent of what is measured, by speed and lateral acceleration; empty "
        "where nobody drove."
      ),
    )
  ]


def _map(panel, cells: Sequence[Cell]) -> None:
  speeds, laterals = sorted({c.speed for c in cells}), sorted({c.lateral for c in cells})
  shares = np.full((len(laterals), len(speeds)), np.nan)
  for c in cells:
    shares[laterals.index(c.lateral), speeds.index(c.speed)] = 100.0 * c.share
  panel.imshow(np.minimum(shares, 50.0), origin="lower", cmap="Blues", vmin=0.0, vmax=50.0, aspect="auto")
  for (i, j), share in np.ndenumerate(shares):
    if np.isfinite(share):
      panel.text(j, i, f"{share:.0f}", ha="center", va="center", fontsize=8, color="white" if share > 30 else "black")
  panel.set_xticks(range(len(speeds)), [_range(s) for s in speeds], rotation=40, ha="right", rotation_mode="anchor")
  panel.set_yticks(range(len(laterals)), [_range(a) for a in laterals])
  panel.grid(False)


def _range(edge: tuple[float, float]) -> str:
  return f">{edge[0]:g}" if math.isinf(edge[1]) else f"{edge[0]:g}–{edge[1]:g}"


def _ovals(result: CrossValidation) -> Section:
  rows = []
  for name, models in result.ovals.items():
    for channel in OVAL_CHANNELS:
      if channel in models["twin"]:
        values = [models[m].get(channel) for m in result.models]
        rows.append((name, f"{_plain(channel)} [{OVAL_CHANNELS[channel]}]", *values, PUBLISHED[channel]))
  text = (
    "Free runs of the ovals, measurement and model passed through the same zero-phase moving average of 0.1 s, beside"
    " the errors that were published for the full-size experiment."
  )
  titles = ("recording", "channel", *(f"RMSE {m}" for m in result.models), "published")
  return Section("Ovals, as the paper reports them", text, [Table("", titles, rows)])


def _runs(result: CrossValidation) -> Section:
  free = result.replays[-1]
  names = free.observations.names
  manoeuvre = {r.name: r.manoeuvre for r in result.dataset.recordings}
  last = {manoeuvre[name]: k for k, name in enumerate(names)}  # one of each
  chosen = sorted(list(last.values())[-_OVERLAYS:])
  pictures = [picture(_overlay(result, free, k), f"{names[k]}: {free.name}.") for k in chosen]
  return Section("Runs", "Measured values beside what the models make of the same commands.", figures=pictures)


@house()
def _overlay(result: CrossValidation, replay: Replay, recording: int) -> Figure:
  own = replay.observations.recording == recording
  channels = [c for c in _DRAWN if np.any(own & replay.observations.select(c))]
  figure, axes = new_figure(max(len(channels), 1), 1, row_height=1.6, share_x=True)
  for panel, channel in zip(axes[:, 0], channels, strict=False):
    rows = np.flatnonzero(own & replay.observations.select(channel))
    rows = rows[:: max(1, len(rows) // _POINTS)]
    time = replay.observations.time[rows]
    draw(panel, time, replay.observations.measured[rows], "measured")
    for model in reversed(result.models):
      draw(panel, time, replay.predicted[model][rows], model)
    panel.set_ylabel(f"{_plain(channel)}\n[{UNITS[channel].replace('^2', '$^2$')}]")
  axes[0, 0].legend(loc="upper right", ncols=3)
  axes[-1, 0].set_xlabel("time [s]")
  return figure


def _by_recording(result: CrossValidation) -> Section:
  free = result.replays[-1]
  rows = []
  for k, name in enumerate(free.observations.names):
    rows += [(name, *row) for row in _rows(result, free, k)]
  return Section("Every recording", "", [Table(_capital(free.name), ("recording", *_titles(result)), rows)])


def _models(result: CrossValidation) -> Section:
  if result.reference is None:
    return Section("The models", f"No bicycle: {result.missing}.")
  text = f"The bicycle was {result.reference.origin}."
  if result.missing:
    text += f" The paper's identification is not possible: {result.missing}."
  if result.twin.mechanisms:
    text += (
      f" Mechanisms of the twin: {', '.join(m.name for m in result.twin.mechanisms)}; those of sensors act on both."
    )
  parameters = result.reference.bicycle.parameters
  rows = [(p.symbol, p.name, float(v), p.unit) for p, v in zip(parameters, result.reference.theta, strict=True)]
  return Section("The models", text, [Table("Bicycle", ("", "parameter", "value", "unit"), rows)])


def _headline(channels: list[str]) -> list[str]:
  speed = "motor_speed" if "motor_speed" in channels else "speed"
  return [c for c in (speed, "yaw_rate", "accel_y") if c in channels]


def _plain(channel: str) -> str:
  return {"accel_x": "acceleration along", "accel_y": "acceleration across"}.get(channel, channel.replace("_", " "))


def _capital(text: str) -> str:
  return text[:1].upper() + text[1:]
