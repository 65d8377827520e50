"""The page of a cross-validation: errors of twin and bicycle by channel, runs, and where the two models differ."""

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
from calibration.fitting.residual_channels import RESIDUALS
from calibration.shown_runs import runs_of
from qcar_twin.atomic_io import write_json
from qcar_twin.pages import Chart, Explorer, Section, Table, bars, heat_map, write_page

_DRAWN = (
  *("motor_speed", "speed", "pose_speed", "path_speed", "yaw_rate", "accel_y", "accel_x"),
  *("pose_forward", "pose_left", "pose_turn", "path_forward", "path_left"),
)
_MOST = 50.0  # per cent of a difference that is coloured


def write_cross_validation(result: CrossValidation, folder: str | os.PathLike[str]) -> Path:
  """Write cross_validation.json and report.html; returns the report's path."""
  folder = Path(folder)
  write_json(folder / "cross_validation.json", result.document())
  driven = sum(r.duration for r in result.dataset.recordings if r.role in result.roles)
  names = result.replays[0].observations.names
  subtitle = f"Data set {result.dataset.name}, role {', '.join(result.roles)}: {len(names)} recordings, {driven:.0f} s"
  title = "Cross-validation of the twin"
  return write_page(folder / "report.html", title, verdict(result), sections(result), subtitle, facts(result))


def verdict(result: CrossValidation) -> str:
  """The outcome in one sentence."""
  window = result.replays[-1]
  twin = window.scores("twin")
  where = "free runs" if math.isinf(window.window) else f"windows of {window.name}"
  sizes = ", ".join(f"{_plain(c)} {twin[c].rmse:.2g} {_unit(c)}" for c in _headline(list(twin)))
  text = f"In {where} the twin errs by {sizes} (root mean square)."
  if result.reference is None:
    return f"{text} There is no bicycle model to compare with."
  bicycle = window.scores("bicycle")
  better = sum(twin[c].rmse < bicycle[c].rmse for c in twin)
  return f"{text} It is nearer to the recordings than the bicycle model on {better} of {len(twin)} channels."


def facts(result: CrossValidation) -> list[tuple[str, str]]:
  """The numbers that go with the verdict: errors of the twin and of the bicycle model in the last window."""
  scores = {m: result.replays[-1].scores(m) for m in result.models}
  rows = []
  for c in _headline(list(scores["twin"])):
    others = [f", {m} {own[c].rmse:.2g}" for m, own in scores.items() if m != "twin"]
    rows.append((f"Error of {_plain(c)} [{_unit(c)}]", f"twin {scores['twin'][c].rmse:.2g}{''.join(others)}"))
  return rows


def sections(result: CrossValidation) -> list[Section]:
  """Everything the page shows, in reading order."""
  parts = [_errors(result), _runs(result)]
  if result.difference:
    parts.append(_parting(result.difference))
  if result.ovals:
    parts.append(_ovals(result))
  parts += [_by_recording(result), _models(result)]
  return parts


def _errors(result: CrossValidation) -> Section:
  text = (
    "A window starts from the measured speed, yaw rate and pose. A free run starts once and is never corrected. RMSE is"
    " the root mean square of predicted minus measured values in the channel's unit. NRMSE is RMSE over the standard"
    " deviation of the measured values: 0 is perfect, 1 is no better than the mean. Displacements are those over 1 s,"
    " or over 0.4 s in windows of 0.5 s."
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
    title = f"{_plain(c)} [{_unit(c)}]"
    rows.append((title, *(s.rmse for s in own), noise, *(s.nrmse for s in own), own[0].samples))
  return rows


def _bars(replay: Replay, models: Sequence[str]) -> Chart:
  scores = {m: replay.scores(m) for m in models}
  channels = ordered(list(scores["twin"]))
  values = {m: [s[c].nrmse for c in channels] for m, s in scores.items()}
  caption = f"{_capital(replay.name)}: NRMSE by channel."
  return bars(caption, [_plain(c) for c in channels], values, "NRMSE", level=(1.0, "no better than the mean"))


def _parting(difference: ModelDifference) -> Section:
  lines = difference.sentences()
  text = (
    "The difference is the root mean square of twin minus bicycle in windows of 2 s, by measured speed and lateral"
    " acceleration (speed times yaw rate). The tables give the error of each model there, too.\n\n"
  )
  text += "\n".join(f"* {line}." for line in lines) or "They differ by less than 5 % of what is measured everywhere."
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
  return Section("Where the two models differ", text, tables, _maps(difference))


def _cell(cell: Cell, edge: tuple[float, float], unit: str) -> tuple:
  low, high = edge
  region = f"above {low:g} {unit}" if math.isinf(high) else f"{low:g} to {high:g} {unit}"
  name = f"{_plain(cell.channel)} [{_unit(cell.channel)}]"
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
    f"{_capital(_plain(channel))}: difference of twin and bicycle in per cent of what is measured; empty where nothing"
    f" was driven, {_MOST:.0f} and more in one colour."
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
        rows.append((name, f"{_plain(channel)} [{_unit(channel)}]", *values, PUBLISHED[channel]))
  text = (
    "Free runs of the ovals. Measurement and model pass the same zero-phase moving average of 0.1 s. The last column"
    " holds the errors that were published for the full-size experiment."
  )
  titles = ("recording", "channel", *(f"RMSE {m}" for m in result.models), "published")
  return Section("Ovals, compared with the paper", text, [Table("", titles, rows)])


def _runs(result: CrossValidation) -> Section:
  free = result.replays[-1]
  notes = {r.name: r.manoeuvre for r in result.dataset.recordings}
  predicted = {m: free.predicted[m] for m in reversed(result.models)}  # the twin on top
  runs = runs_of(free.observations, predicted, noise=result.noise, channels=_DRAWN, notes=notes)
  runs.sort(key=lambda run: -run.seconds)
  caption = f"Measured channels, and what the models predict for the same commands: {free.name}."
  return Section("Channels and map", "", figures=[Explorer(caption, runs)])


def _by_recording(result: CrossValidation) -> Section:
  free = result.replays[-1]
  rows = []
  for k, name in enumerate(free.observations.names):
    rows += [(name, *row) for row in _rows(result, free, k)]
  return Section("Errors by recording", "", [Table(_capital(free.name), ("recording", *_titles(result)), rows)])


def _models(result: CrossValidation) -> Section:
  if result.reference is None:
    return Section("The models", f"There is no bicycle model: {result.missing}.")
  text = f"The bicycle model was {result.reference.origin}."
  if result.missing:
    text += f" The paper's identification is not possible: {result.missing}."
  if result.twin.mechanisms:
    text += (
      f" The twin has these mechanisms: {', '.join(m.name for m in result.twin.mechanisms)}. Those of sensors act on"
      " both models."
    )
  parameters = result.reference.bicycle.parameters
  rows = [(p.symbol, p.name, float(v), p.unit) for p, v in zip(parameters, result.reference.theta, strict=True)]
  return Section("The models", text, [Table("Bicycle model", ("symbol", "parameter", "value", "unit"), rows)])


def _headline(channels: list[str]) -> list[str]:
  speed = "motor_speed" if "motor_speed" in channels else "speed"
  return [c for c in (speed, "yaw_rate", "accel_y") if c in channels]


def _plain(channel: str) -> str:
  return RESIDUALS[channel].words if channel in RESIDUALS else channel.replace("_", " ")


def _unit(channel: str) -> str:
  return UNITS[channel].replace("^2", "²") if channel in UNITS else OVAL_CHANNELS[channel].replace("^2", "²")


def _capital(text: str) -> str:
  return text[:1].upper() + text[1:]
