"""The page of a cross-validation: errors of twin and bicycle by window and channel, where they part, runs overlaid."""

import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.cross_validation.cross_validation import CrossValidation, Replay, ordered
from calibration.cross_validation.free_run import CHANNELS as OVAL_CHANNELS
from calibration.cross_validation.free_run import PUBLISHED
from calibration.cross_validation.model_difference import Cell, ModelDifference
from calibration.fitting.observations import UNITS
from calibration.shown_runs import runs_of
from qcar_twin.atomic_io import write_json
from qcar_twin.pages import Chart, Explorer, Section, Table, bars, heat_map, write_page

_DRAWN = ("motor_speed", "speed", "yaw_rate", "accel_y", "accel_x", "pose_forward", "pose_left", "pose_turn")
_MOST = 50.0  # per cent of a difference that is coloured


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
  return Section("Errors by window and channel", text, tables, [_bars(result.replays[-1], result.models)])


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


def _bars(replay: Replay, models: Sequence[str]) -> Chart:
  scores = {m: replay.scores(m) for m in models}
  channels = ordered(list(scores["twin"]))
  values = {m: [s[c].nrmse for c in channels] for m, s in scores.items()}
  caption = f"{_capital(replay.name)}: NRMSE by channel."
  return bars(caption, [_plain(c) for c in channels], values, "NRMSE", level=(1.0, "no better than the mean"))


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


def _maps(difference: ModelDifference) -> list[Chart]:
  channels = [c for c in ("yaw_rate", "accel_y") if any(cell.channel == c for cell in difference.grid)]
  return [_map(name, [c for c in difference.grid if c.channel == name]) for name in channels]


def _map(channel: str, cells: Sequence[Cell]) -> Chart:
  speeds, laterals = sorted({c.speed for c in cells}), sorted({c.lateral for c in cells})
  shares = np.full((len(laterals), len(speeds)), np.nan)
  for c in cells:
    shares[laterals.index(c.lateral), speeds.index(c.speed)] = 100.0 * c.share
  caption = (
    f"{_capital(_plain(channel))}: difference of twin and bicycle in per cent of what is measured; empty where nobody"
    f" drove, {_MOST:.0f} and more in one colour."
  )
  titles = ("speed [m/s]", "lateral acceleration [m/s²]", "%")
  return heat_map(caption, [_range(e) for e in speeds], [_range(e) for e in laterals], shares, titles, (0.0, _MOST))


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
  notes = {r.name: r.manoeuvre for r in result.dataset.recordings}
  predicted = {m: free.predicted[m] for m in reversed(result.models)}  # the twin on top
  runs = runs_of(free.observations, predicted, noise=result.noise, channels=_DRAWN, notes=notes)
  runs.sort(key=lambda run: -run.seconds)
  caption = f"Measured values beside what the models make of the same commands: {free.name}."
  return Section("Runs", "", figures=[Explorer(caption, runs)])


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
