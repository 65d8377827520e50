"""The page of a calibration: verdict, errors on recordings, step responses, every parameter with ± and its shift."""

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration.fitting.residual_channels import RESIDUALS
from calibration.identification.identification import Identification
from calibration.identification.match_bicycle import PARTS, Answer, step_speed
from calibration.shown_runs import runs_of
from calibration.twin_calibration.calibration import Calibration, ChannelError
from calibration.twin_calibration.estimates import Estimate
from calibration.twin_calibration.measured_steps import MeasuredSteps, measured_steps
from qcar_twin.atomic_io import write_json
from qcar_twin.pages import Cell, Chart, Explorer, Section, Table, bars, line, panels, write_page
from qcar_twin.pages.numbers import spread
from qcar_twin.twin.file import save_twin

_PANELS = 4
_STEERING_SHOWN = 1.3  # s after a step of the steering
_AT_ZERO = 1e-6  # s
_LABELS = {"before": "twin before", "twin": "calibrated twin"}
_NOTICED = 0.01  # of an error: what makes less of a difference nobody misses, a stated prior
_WORSE = (
  "It errs more than before the calibration in {}: either a number of the car is wrong by more than [vehicle.std] in"
  " dataset.toml states, or the fitted recordings lack such driving. Look at the recordings below before you use it."
)
_PART_WORDS = {"longitudinal": "motor speed", "lateral": "lateral acceleration", "yaw_rate": "yaw rate"}
_FAR = 3.0  # standard deviations of a prior that are worth a word


def write_calibration(calibration: Calibration, folder: str | os.PathLike[str]) -> Path:
  """Write twin.toml, calibration.json and report.html; returns the report's path."""
  folder, name = Path(folder), calibration.dataset.name
  note = f"calibrated on {name} against {calibration.against}"
  save_twin(folder / "twin.toml", calibration.twin, calibration.theta, note, calibration.command_shift)
  write_json(folder / "calibration.json", calibration.document())
  dataset = calibration.dataset
  subtitle = f"Data set {dataset.name}: {len(dataset.recordings)} recordings, {_minutes(calibration)}"
  return write_page(
    folder / "report.html", "Calibration of the twin", verdict(calibration), sections(calibration), subtitle,
    facts(calibration),
  )  # fmt: skip


def verdict(calibration: Calibration) -> str:
  """The outcome in one sentence."""
  if calibration.against == "identified":
    percent = calibration.step_percent("longitudinal")
    text = f"The twin answers the identified model's steps of the drive's command within {percent:.2g} %"
    lateral = calibration.step_percent("lateral")
    steers = f" and its step steers within {lateral:.2g} % of lateral acceleration" if math.isfinite(lateral) else ""
    return f"{text}{steers} (root mean square over the response, mean over the steps)."
  judged = "validate" if "validate" in calibration.errors else "identify"
  which = "validation recordings" if judged == "validate" else "the recordings it was fitted to"
  best = [
    f"{_words(c)} {_with_unit(e.after, c)} (before {_with_unit(e.before, c)})"
    for c, e in _headline(calibration, judged)
  ]
  said = f"On {which} the calibrated twin errs by {', '.join(best)} (root mean square)."
  worse = [_words(c) for c, e in calibration.errors[judged].items() if e.after > (1.0 + _NOTICED) * e.before]
  return f"{said} {_WORSE.format(', '.join(worse))}" if worse else said


def facts(calibration: Calibration) -> list[tuple[str, str]]:
  """The numbers that go with the verdict: errors before and after, with the sensor noise."""
  if not calibration.errors:
    return []
  judged = "validate" if "validate" in calibration.errors else "identify"
  return [
    (f"Error of {_words(c)}", f"{e.before:.2g} → {_with_unit(e.after, c)} (sensor noise {e.noise_floor:.2g})")
    for c, e in _headline(calibration, judged)
  ]


def sections(calibration: Calibration) -> list[Section]:
  """Everything the page shows, in reading order."""
  parts = []
  if calibration.errors:
    parts.append(_recordings(calibration))
  if calibration.answers:
    parts.append(_steps(calibration))
  parts.append(_parameters(calibration))
  if calibration.identification:
    parts.append(identification_section(calibration.identification))
  elif calibration.missing:
    parts.append(Section("Identified bicycle model", f"The bicycle model was not identified: {calibration.missing}."))
  if calibration.notes:
    parts.append(Section("Warnings", "\n".join(f"* {note}" for note in calibration.notes)))
  return parts


def identification_section(bicycle: Identification) -> Section:
  """The bicycle's five parameters and how well it answers the steps it was made from."""
  rows = []
  for parameter, value, std in zip(bicycle.parameters, bicycle.theta, bicycle.std, strict=True):
    known = bicycle.lateral is not None or not parameter.name.startswith("cornering")
    rows.append((parameter.symbol, parameter.name, spread(value, std) if known else "–", parameter.unit))
  errors = [
    (_PART_WORDS[part], role, bicycle.rmse_percent(part, role), bicycle.steady_error(part, role))
    for part in ("longitudinal", "lateral", "yaw_rate")
    for role in ("identify", "validate")
    if math.isfinite(bicycle.rmse_percent(part, role))
  ]
  text = "The paper's bicycle model from steps of the drive's command and step steers, by least squares in two stages."
  if bicycle.missing:
    text += f" Not identified: {bicycle.missing}."
  tables = [Table("Parameters of the bicycle model", ("symbol", "name", "value ±", "unit"), rows)]
  titles = ("response", "role", "RMSE [% of the steady value]", "steady error at most [rad/s, m/s², rad/s]")
  return Section(
    "Identified bicycle model", text, [*tables, Table("Bicycle against the measured step responses", titles, errors)]
  )


def _steps(calibration: Calibration) -> Section:
  rows = []
  for part in PARTS:
    percents = [calibration.step_percent(part, role) for role in ("identify", "validate")]
    if any(map(math.isfinite, percents)):
      rows.append((_PART_WORDS[part], *percents))
  text = (
    "Twin and identified bicycle answer the same steps of the drive's command from rest and the same step steers at"
    f" {step_speed(calibration.twin.vehicle):.3g} m/s. The measured response is drawn where a recording holds the same"
    " step from the same start. Lateral acceleration is that of the motion. An accelerometer on the rolling body also"
    " feels a part of gravity, which both models leave out."
  )
  if calibration.against == "recordings":
    text += " The twin was fitted to the recordings, not to these steps: the difference is what the bicycle lacks."
  table = Table("Difference of twin and bicycle, RMSE in per cent of the steady value, mean over steps",
                ("response", "steps that were identified with", "validation steps"), rows)  # fmt: skip
  return Section("Step responses", text, [table], _step_charts(calibration))


def _step_charts(calibration: Calibration) -> list[Chart]:
  measured = measured_steps(calibration.dataset.recordings, calibration.twin.vehicle)
  captions = {
    "motor_speed": "Steps of the drive's command from rest.",
    "accel_y": "Lateral acceleration after a step of the steering.",
    "yaw_rate": "Yaw rate after a step of the steering.",
  }
  charts = []
  for channel, caption in captions.items():
    chosen = sorted((a for a in calibration.answers if a.channel == channel), key=lambda a: abs(a.level.value))
    if chosen:
      caption += " Above each chart: level, role, and the difference of twin and bicycle in per cent."
      charts.append(step_chart(chosen, measured, caption, calibration.twin.vehicle.motor.unit))
  return charts


def step_chart(answers: Sequence[Answer], measured: MeasuredSteps, caption: str, unit: str) -> Chart:
  """Some steps of one channel from the moment of the step on, unfiltered: measured, bicycle and twin; `unit` of the
  drive's command."""
  chosen = [answers[i] for i in np.unique(np.linspace(0, len(answers) - 1, _PANELS).round().astype(int))]
  parts = []
  for answer in chosen:
    steering = answer.channel != "motor_speed"
    level = (
      f"{math.degrees(answer.level.value):.3g}°" if steering else f"{answer.level.value:.3g} {unit}".removesuffix(" -")
    )
    until = _STEERING_SHOWN if steering else float(answer.time[-1])
    shown = (answer.time > -_AT_ZERO) & (answer.time <= until)
    twin, bicycle = answer.drawn
    lines = [line(answer.time[shown], y[shown], who) for who, y in (("bicycle", bicycle), ("twin", twin))]
    response = measured.response(answer)
    if response is not None:
      early = response[0] <= until
      lines.insert(0, line(response[0][early], response[1][early], "measured"))
    heading = f"{level}, {answer.level.role}: {answer.rmse_percent:.2g} %"
    parts.append((heading, RESIDUALS[answer.channel].axis, lines))
  return panels(caption, parts, "time since the step [s]")


def _recordings(calibration: Calibration) -> Section:
  tables = [
    Table(
      {"identify": "Recordings it was fitted to", "validate": "Validation recordings"}[role],
      ("channel", "before", "calibrated", "sensor noise", "calibrated / noise"),
      [(RESIDUALS[c].axis, e.before, e.after, e.noise_floor, e.after / e.noise_floor) for c, e in items.items()],
    )
    for role, items in sorted(calibration.errors.items(), reverse=True)
  ]
  text = (
    "An error is the root mean square of predicted minus measured values on stretches of up to 6 s, each started from"
    " the measurement. Before is the twin with the car's measured and nominal numbers. Displacements are those over 1"
    " s, seen from the car."
  )
  if calibration.command_shift:
    text += f" Commands act {calibration.command_shift} control periods of 10 ms later than logged."
  judged = "validate" if "validate" in calibration.errors else "identify"
  chart = error_chart(
    calibration.errors[judged], "validation recordings" if judged == "validate" else "fitted recordings"
  )
  return Section("Errors before and after", text, tables, [chart, *_explorer(calibration)])


def error_chart(errors: Mapping[str, ChannelError], where: str) -> Chart:
  """Errors by channel before and after calibration, in multiples of the sensor noise."""
  known = {c: e for c, e in errors.items() if e.noise_floor > 0.0}
  values = {"before": [e.before / e.noise_floor for e in known.values()],
            "twin": [e.after / e.noise_floor for e in known.values()]}  # fmt: skip
  caption = f"Errors on {where} in multiples of the sensor noise."
  names = [_words(c) for c in known]
  return bars(caption, names, values, "error / sensor noise", level=(1.0, "sensor noise"), labels=_LABELS)


def _explorer(calibration: Calibration) -> list[Explorer]:
  if calibration.replay is None:
    return []
  before, after = calibration.replay.predicted
  noise = {c: e.noise_floor for items in calibration.errors.values() for c, e in items.items()}
  roles = {r.name: r.role for r in calibration.dataset.recordings}
  runs = runs_of(calibration.replay.observations, {"before": before, "twin": after}, _LABELS, noise, notes=roles)
  runs.sort(key=lambda run: (run.note != "validate", -run.seconds))
  caption = (
    "Measured channels, and what the twin predicts for the same commands. Lines break where the simulation restarts"
    " from the measurement."
  )
  return [Explorer(caption, runs)]


def _parameters(calibration: Calibration) -> Section:
  rows: list[tuple[Cell, ...]] = []
  for name, e in calibration.estimates.items():
    prior, fitted = spread(e.prior, e.prior_std), not e.reason_not_fitted
    shift = (e.value - e.prior) / e.prior_std if fitted and e.prior_std > 0.0 else None
    rows.append((name, e.unit, prior, spread(e.value, e.std) if fitted else "–", shift, _remark(e, shift)))
  titles = ("parameter", "unit", "prior ±", "calibrated ±", "shift", "remark")
  text = (
    "The shift is the calibrated value minus that of the prior, in standard deviations of the prior. A parameter counts"
    " as identified where the recordings halve the variance of its prior. The calibrated standard deviation covers"
    " disturbances that neighbouring samples share. It also covers what the twin's simplifications move such a figure"
    " by, as measured on cars whose figures are known. 1.645 of it are meant to hold 90 %."
  )
  return Section("Parameters and how far they moved", text, [Table("Parameters", titles, rows, unfolded=True)])


def _remark(e: Estimate, shift: float | None) -> str:
  if e.reason_not_fitted:
    return e.reason_not_fitted
  said = "at its bound" if e.at_bound else "identified" if e.identifiable else "mostly the prior"
  return f"{said}, far from the prior" if shift is not None and abs(shift) > _FAR else said


def _headline(calibration: Calibration, role: str) -> list[tuple[str, ChannelError]]:
  items = calibration.errors[role]
  ways = (
    ("motor_speed", "speed", "pose_speed", "path_speed"),
    ("yaw_rate", "pose_turn", "path_left"),
    ("accel_y",),
  )  # the best of each that is there
  chosen = [next((name for name in names if name in items), "") for names in ways]
  return [(name, items[name]) for name in chosen if name]


def _words(channel: str) -> str:
  return RESIDUALS[channel].words


def _with_unit(value: float, channel: str) -> str:
  return f"{value:.2g} {RESIDUALS[channel].symbol}"


def _minutes(calibration: Calibration) -> str:
  seconds = sum(r.duration for r in calibration.dataset.recordings)
  return f"{seconds:.0f} s of driving" if seconds < 120 else f"{seconds / 60:.1f} min of driving"
