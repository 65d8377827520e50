"""What calibration and cross-validation reach on several data sets, as one page of tables.

  record = judge("../shared/data/dart", "out/calibrations/dart")   # runs what it does not find there
  text = page([record], steps)

Everything on the page is read from calibration.json and cross_validation.json, so a page can be written again without
a fit.
"""

import dataclasses
import json
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration.cross_validation.cross_validation import MODELS, cross_validate, find_reference
from calibration.cross_validation.report import write_cross_validation
from calibration.fitting.informative import split_standing
from calibration.fitting.observations import CHANNELS
from calibration.fitting.windows import Cut
from calibration.progress import CALIBRATION, CROSS_VALIDATION, Plan, Progress, joined, silent, under
from calibration.twin_calibration.calibration import Against, calibrate
from calibration.twin_calibration.report import write_calibration
from qcar_twin import markdown
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.file import load_twin

Document = Mapping[str, Any]

STEPS_AIM = {"longitudinal": 1.0, "lateral": 2.0}  # per cent of the steady value
REFERENCE_DRIVE = 300.0  # s of driving a bicycle is fitted to where it can't be identified
_SPEEDS = ("speed", "motor_speed")


@dataclasses.dataclass(frozen=True)
class Record:
  """A data set with its calibration against the recordings and its cross-validation."""

  dataset: DataSet
  calibration: Document
  cross_validation: Document


def match(
  dataset: str | os.PathLike[str], folder: str | os.PathLike[str], threads: int = 0, progress: Progress = silent
) -> Document:
  """calibration.json of the twin fitted to the identified model; made in `folder` where it isn't there yet."""
  return _calibrated(DataSet.load(dataset), Path(folder), "identified", threads, progress)


def judge(
  dataset: str | os.PathLike[str], folder: str | os.PathLike[str], threads: int = 0, progress: Progress = silent
) -> Record:
  """Calibration against the recordings and cross-validation; made below `folder` where they aren't there yet.

  Recordings with role "validate" are predicted; where there are none, those the fit saw, and the page says so.
  """
  data, folder = DataSet.load(dataset), Path(folder)
  calibration = _calibrated(data, folder / "calibration", "recordings", threads, progress)
  where = folder / "cross_validation"
  make = lambda: _cross_validated(data, folder / "calibration", where, threads, progress)
  validation = _kept(where / "cross_validation.json", make)
  return Record(data, calibration, validation)


def to_match(name: str, folder: Path) -> Plan:
  """Stages of what `match` has still to make in a folder, under a name."""
  return {} if (folder / "calibration.json").is_file() else under(name, CALIBRATION)


def to_judge(name: str, folder: Path) -> Plan:
  """Those of `judge`."""
  validated = (folder / "cross_validation" / "cross_validation.json").is_file()
  return joined(to_match(name, folder / "calibration"), {} if validated else under(name, CROSS_VALIDATION))


def _calibrated(dataset: DataSet, folder: Path, against: Against, threads: int, progress: Progress) -> Document:
  make = lambda: write_calibration(calibrate(dataset, against, folder, threads=threads, progress=progress), folder)
  return _kept(folder / "calibration.json", make)


def _cross_validated(dataset: DataSet, calibration: Path, out: Path, threads: int, progress: Progress) -> None:
  twin, theta = load_twin(calibration / "twin.toml", threads=threads)
  shift = int(json.loads((calibration / "calibration.json").read_text(encoding="utf-8"))["command_shift"])
  reference, missing = find_reference(dataset, Cut(most=REFERENCE_DRIVE, command_shift=shift), progress)
  roles = ("validate",) if dataset.role("validate") else ("identify",)
  result = cross_validate(dataset, twin, theta, reference, roles, shift, missing=missing, progress=progress)
  write_cross_validation(result, out)


def _kept(path: Path, make: Callable[[], object]) -> Document:
  if not path.is_file():
    make()
  return json.loads(path.read_text(encoding="utf-8"))


# -- tables --------------------------------------------------------------------------------------


def page(records: Sequence[Record], steps: Mapping[str, Document]) -> str:
  """Markdown: step responses by data set, then every data set with recordings."""
  parts = ["## Twin against the identified model", steps_table(steps)] if steps else []
  for record in records:
    parts += [f"## {record.dataset.name}", about(record), errors_table(record.calibration)]
    parts += ["Prediction, RMSE (NRMSE) of twin / bicycle:", windows_table(record.cross_validation)]
    manoeuvres = by_manoeuvre(record)
    if len(manoeuvres) > 1:
      parts += ["By manoeuvre, windows of 2 s, RMSE of twin / bicycle:", manoeuvre_table(manoeuvres)]
    parts += ["By recording, speed in free run:", runs_table(record)]
  return "\n\n".join(parts) + "\n"


def steps_table(documents: Mapping[str, Document]) -> str:
  """Root mean square difference on step responses, per cent of the steady value, mean over the steps."""
  rows = []
  for name, document in documents.items():
    steps = document["steps_rmse_percent"]
    cells = [f"{steps[part][role]:.2f}" for part in ("longitudinal", "lateral", "yaw_rate") for role in steps[part]]
    missed = [p for p, aim in STEPS_AIM.items() if not max(steps[p].values()) <= aim]
    rows.append([name, *cells, f"missed: {', '.join(missed)}" if missed else "reached"])
  aims = " and ".join(f"{part} <= {aim:g} %" for part, aim in STEPS_AIM.items())
  sides = [
    f"{part}, {role} [%]" for part in ("longitudinal", "lateral", "yaw_rate") for role in ("identify", "validate")
  ]
  return "\n".join(markdown.table(["data set", *sides, aims], rows))


def about(record: Record) -> str:
  """How much there is, where the bicycle is from, what the calibration had to say."""
  dataset, calibration, validation = record.dataset, record.calibration, record.cross_validation
  driven = {role: sum(r.duration for r in dataset.role(role)) for role in ("identify", "validate", "holdout")}
  counts = ", ".join(f"{len(dataset.role(role))} {role} ({s:.0f} s)" for role, s in driven.items() if s)
  lines = [f"{len(dataset.recordings)} recordings: {counts}."]
  if "validate" not in validation["roles"]:
    roles = ", ".join(validation["roles"])
    lines.append(f"There are none to judge by: the predictions below are of the role {roles}, which was fitted.")
  bicycle = validation["bicycle"]
  missing = f" ({validation['missing']})" if validation["missing"] else ""
  lines.append(f"Bicycle: {bicycle['origin'] if bicycle else 'none'}{missing}.")
  if calibration["command_shift"]:
    lines.append(f"Commands act {calibration['command_shift']} control periods later than logged.")
  notes = [note for note in calibration["notes"] if note not in dataset.notices]
  return "\n".join(lines + [f"* {note}" for note in notes])


def errors_table(calibration: Document) -> str:
  """Errors on stretches of 6 s at most, before and after the calibration, with the sensor's noise."""
  errors = calibration["errors"]
  roles = [role for role in ("identify", "validate") if role in errors]
  rows = []
  for channel in _ordered(errors[roles[0]]):
    items = [errors[role].get(channel) for role in roles]
    cells = [f"{e['before']:.3g} -> {e['after']:.3g}" if e else "" for e in items]
    first = next(e for e in items if e)
    rows.append([f"{channel} [{first['unit']}]", *cells, _number(first["noise_floor"])])
  return "\n".join(
    markdown.table(["calibration, RMSE", *(f"{role}: before -> after" for role in roles), "sensor noise"], rows)
  )


def windows_table(validation: Document) -> str:
  """RMSE (NRMSE) of both models by channel and window."""
  windows = validation["windows"]
  rows = []
  for channel in _ordered(next(iter(windows.values()))["twin"]):
    cells = [" / ".join(_score(w[m][channel]) for m in MODELS if m in w) for w in windows.values()]
    unit = next(iter(windows.values()))["twin"][channel]["unit"]
    rows.append([f"{channel} [{unit}]", *cells])
  return "\n".join(markdown.table(["channel", *windows], rows))


def by_manoeuvre(record: Record, window: str = "2 s") -> dict[str, dict[str, dict[str, float]]]:
  """Manoeuvre -> channel -> model -> RMSE over all of its recordings, each value counted once."""
  manoeuvre = {r.name: r.manoeuvre or "other" for r in record.dataset.recordings}
  squares: dict[tuple[str, str, str], list[tuple[float, int]]] = {}
  for name, windows in record.cross_validation["recordings"].items():
    for model, channels in windows.get(window, {}).items():
      for channel, score in channels.items():
        squares.setdefault((manoeuvre[name], channel, model), []).append((score["rmse"] ** 2, score["samples"]))
  out: dict[str, dict[str, dict[str, float]]] = {}
  for (what, channel, model), parts in squares.items():
    power, count = np.array(parts).T
    out.setdefault(what, {}).setdefault(channel, {})[model] = math.sqrt(float(power @ count) / float(count.sum()))
  return out


def manoeuvre_table(errors: Mapping[str, Mapping[str, Mapping[str, float]]]) -> str:
  """A row per manoeuvre, a column per channel."""
  channels = _ordered({channel for row in errors.values() for channel in row})
  rows = []
  for what, row in errors.items():
    rows.append([what, *(" / ".join(f"{x:.3g}" for x in row.get(c, {}).values()) for c in channels)])
  return "\n".join(markdown.table(["manoeuvre", *channels], rows))


def runs_table(record: Record, window: str = "free run") -> str:
  """Speed RMSE of every recording that was predicted, and whether the car moves in it; the mean over those that do."""
  standing = split_standing(record.dataset.recordings)[1]
  rows, moving = [], []
  for name, windows in record.cross_validation["recordings"].items():
    scores = windows[window]
    channel = next(c for c in _SPEEDS if c in scores["twin"])
    values = [scores[m][channel]["rmse"] for m in MODELS if m in scores]
    unit = scores["twin"][channel]["unit"]
    rows.append([name, "no" if name in standing else "yes", *(f"{v:.3g} {unit}" for v in values)])
    if name not in standing:
      moving.append(values)
  models = [m for m in MODELS if m in record.cross_validation["windows"][window]]
  if moving:
    rows.append(["mean of those that move", "", *(f"{v:.3g}" for v in np.mean(moving, axis=0))])
  return "\n".join(markdown.table(["recording", "moves", *models], rows))


def _score(score: Mapping[str, Any]) -> str:
  share = score["nrmse"]
  return f"{score['rmse']:.3g}" + ("" if share is None else f" ({share:.2f})")


def _number(value: float | None) -> str:
  return "" if value is None else f"{value:.2g}"


def _ordered(channels: Iterable[str]) -> list[str]:
  present = set(channels)
  return [c for c in CHANNELS if c in present]
