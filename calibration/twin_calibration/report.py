"""The page of a calibration: verdict, step responses, errors on recordings, every parameter with its deviation."""

import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.fitting.residual_channels import RESIDUALS
from calibration.identification.identification import Identification
from calibration.identification.match_bicycle import PARTS, Answer
from calibration.shown_runs import runs_of
from calibration.twin_calibration.calibration import Calibration, ChannelError
from qcar_twin.atomic_io import write_json
from qcar_twin.bicycle.bicycle import PARAMETERS
from qcar_twin.pages import Chart, Explorer, Section, Table, line, panels, write_page
from qcar_twin.twin.file import save_twin

_PANELS = 4
_NOTICED = 0.01  # of an error: what makes less of a difference nobody misses, a stated prior
_WORSE = (
  "It errs more than before the calibration in {}: either numbers of the car are wrong by more than [vehicle.std] of"
  " dataset.toml says, or the fitted recordings lack driving like that. Look at the recordings below before you use it."
)


def write_calibration(calibration: Calibration, folder: str | os.PathLike[str]) -> Path:
  """Write twin.toml, calibration.json and report.html; returns the report's path."""
  folder, name = Path(folder), calibration.dataset.name
  save_twin(
    folder / "twin.toml", calibration.twin, calibration.theta, f"calibrated on {name} against {calibration.against}"
  )
  write_json(folder / "calibration.json", calibration.document())
  dataset = calibration.dataset
  subtitle = f"Data set {dataset.name}: {len(dataset.recordings)} recordings, {_minutes(calibration)}"
  return write_page(
    folder / "report.html", "Calibration of the twin", verdict(calibration), sections(calibration), subtitle
  )


def verdict(calibration: Calibration) -> str:
  """The outcome in one sentence."""
  if calibration.against == "identified":
    text = (
      f"The twin answers the identified model's voltage steps within {calibration.step_percent('longitudinal'):.2g} %"
    )
    lateral = calibration.step_percent("lateral")
    steers = f" and its step steers within {lateral:.2g} % of lateral acceleration" if math.isfinite(lateral) else ""
    return f"{text}{steers} (root mean square over the response, mean over the steps)."
  judged = "validate" if "validate" in calibration.errors else "identify"
  which = "recordings that took no part in the fit" if judged == "validate" else "the recordings it was fitted to"
  best = [
    f"{_words(c)} {_with_unit(e.after, c)} (before {_with_unit(e.before, c)})"
    for c, e in _headline(calibration, judged)
  ]
  said = f"On {which} the calibrated twin errs by {', '.join(best)} (root mean square)."
  worse = [_words(c) for c, e in calibration.errors[judged].items() if e.after > (1.0 + _NOTICED) * e.before]
  return f"{said} {_WORSE.format(', '.join(worse))}" if worse else said


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
    parts.append(Section("Identified model", f"The bicycle model was not identified: {calibration.missing}."))
  if calibration.notes:
    parts.append(Section("What to know", "\n".join(f"* {note}" for note in calibration.notes)))
  return parts


def identification_section(found: Identification) -> Section:
  """The bicycle's five parameters and how well it answers the steps it was made from."""
  rows = []
  for parameter, value, std in zip(PARAMETERS, found.theta, found.std, strict=True):
    known = found.lateral is not None or not parameter.name.startswith("cornering")
    rows.append((parameter.symbol, parameter.name, value if known else None, std if known else None, parameter.unit))
  errors = [
    (part, role, found.rmse_percent(part, role), found.steady_error(part, role))
    for part in ("longitudinal", "lateral", "yaw_rate")
    for role in ("identify", "validate")
    if math.isfinite(found.rmse_percent(part, role))
  ]
  text = "The paper's bicycle model from voltage steps and step steers, by least squares in two stages."
  if found.missing:
    text += f" Not identified: {found.missing}."
  tables = [Table("Parameters", ("", "name", "value", "standard deviation", "unit"), rows)]
  titles = ("part", "role", "RMSE [% of the steady value]", "steady error at most [rad/s, m/s², rad/s]")
  return Section(
    "Identified model", text, [*tables, Table("Bicycle against the measured step responses", titles, errors)]
  )


def _steps(calibration: Calibration) -> Section:
  rows = []
  for part in PARTS:
    percents = [calibration.step_percent(part, role) for role in ("identify", "validate")]
    if any(map(math.isfinite, percents)):
      rows.append((part, *percents))
  text = (
    "Twin and identified bicycle answer the same voltage steps from rest and the same step steers at 1.5 m/s. Lateral"
    " acceleration is the motion's; what an accelerometer on the rolling body feels of gravity is left out."
  )
  if calibration.against == "recordings":
    text += " The twin was fitted to the recordings, not to these steps: the difference is what the bicycle lacks."
  table = Table("Difference of twin and bicycle, RMSE in per cent of the steady value, mean over steps",
                ("part", "steps that were identified with", "validation steps"), rows)  # fmt: skip
  return Section("Step responses", text, [table], _step_charts(calibration.answers))


def _step_charts(answers: Sequence[Answer]) -> list[Chart]:
  captions = {
    "motor_speed": "Steps of the drive's command from rest.",
    "accel_y": "Lateral acceleration after a step of the steering.",
    "yaw_rate": "Yaw rate after a step of the steering.",
  }
  charts = []
  for channel, caption in captions.items():
    chosen = sorted((a for a in answers if a.channel == channel), key=lambda a: abs(a.level.value))
    if chosen:
      charts.append(_step_chart(chosen, f"{caption} Above each: level and role, difference in per cent."))
  return charts


def _step_chart(answers: Sequence[Answer], caption: str) -> Chart:
  chosen = [answers[i] for i in np.unique(np.linspace(0, len(answers) - 1, _PANELS).round().astype(int))]
  parts = []
  for answer in chosen:
    steering = answer.channel != "motor_speed"
    level = f"{math.degrees(answer.level.value):.3g}°" if steering else f"{answer.level.value:.3g} V"
    shown = (answer.time >= -0.2) & (answer.time <= 1.3) if steering else np.full(len(answer.time), True)
    lines = [line(answer.time[shown], y[shown], who) for who, y in (("bicycle", answer.bicycle), ("twin", answer.twin))]
    heading = f"{level}, {answer.level.role}: {answer.rmse_percent:.2g} %"
    parts.append((heading, RESIDUALS[answer.channel].axis, lines))
  return panels(caption, parts, "time since the step [s]")


def _recordings(calibration: Calibration) -> Section:
  tables = [
    Table(
      {"identify": "Recordings it was fitted to", "validate": "Recordings kept to validate"}[role],
      ("channel", "before", "calibrated", "sensor noise", "calibrated / noise"),
      [(RESIDUALS[c].axis, e.before, e.after, e.noise_floor, e.after / e.noise_floor) for c, e in items.items()],
    )
    for role, items in calibration.errors.items()
  ]
  text = (
    "Root mean square errors on stretches of up to 6 s, each started from what was measured. Before: the car's measured"
    " and nominal numbers. Displacements are over 1 s, seen from the car."
  )
  if calibration.command_shift:
    text += f" Commands act {calibration.command_shift} control periods of 10 ms later than logged."
  return Section("Errors on recordings", text, tables, _explorer(calibration))


def _explorer(calibration: Calibration) -> list[Explorer]:
  if calibration.replay is None:
    return []
  before, after = calibration.replay.predicted
  noise = {c: e.noise_floor for items in calibration.errors.values() for c, e in items.items()}
  roles = {r.name: r.role for r in calibration.dataset.recordings}
  labels = {"before": "twin before", "twin": "twin calibrated"}
  runs = runs_of(calibration.replay.observations, {"before": before, "twin": after}, labels, noise, notes=roles)
  runs.sort(key=lambda run: (run.note != "validate", -run.seconds))
  caption = (
    "What was measured, and what the twin makes of the same commands. Lines break where the simulation starts anew from"
    " the measurement."
  )
  return [Explorer(caption, runs)]


def _parameters(calibration: Calibration) -> Section:
  rows = []
  for name, e in calibration.estimates.items():
    said = e.reason_not_fitted or (
      "at its bound" if e.at_bound else "identified" if e.identifiable else "mostly the prior"
    )
    rows.append((name, e.value, None if e.reason_not_fitted else e.std, e.prior, e.prior_std, e.unit, said))
  titles = ("parameter", "value", "standard deviation", "prior", "its deviation", "unit", "")
  text = (
    "A parameter counts as identified where the data halve the variance of its prior. Standard deviations hold what"
    " the model can't know about itself only as far as its own residuals show it."
  )
  return Section("Parameters", text, [Table("", titles, rows)])


def _headline(calibration: Calibration, role: str) -> list[tuple[str, ChannelError]]:
  items = calibration.errors[role]
  chosen = ["motor_speed" if "motor_speed" in items else "speed", "yaw_rate", "accel_y"]
  return [(name, items[name]) for name in chosen if name in items]


def _words(channel: str) -> str:
  return RESIDUALS[channel].words


def _with_unit(value: float, channel: str) -> str:
  return f"{value:.2g} {RESIDUALS[channel].symbol}"


def _minutes(calibration: Calibration) -> str:
  seconds = sum(r.duration for r in calibration.dataset.recordings)
  return f"{seconds:.0f} s of driving" if seconds < 120 else f"{seconds / 60:.1f} min of driving"
