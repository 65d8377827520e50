"""Cross-validation: twin and bicycle against recordings that took no part in their fits.

  result = cross_validate(dataset, twin, theta, baseline)
  result.write("out/cross_validation")

Windows of 0.5 s and 2 s are started anew from what was measured, a free run never is. RMSE is in the channel's
unit; NRMSE is RMSE over the standard deviation of what was measured: 1 is no better than the mean. Displacements
(pose_forward, pose_left, pose_turn) are over 1 s, over 0.4 s in windows of 0.5 s.
"""

import dataclasses
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.bicycle_fit import fit_bicycle
from calibration.diagnosis.passport import noise_passport
from calibration.diagnosis.recalibrate import sensor_floor
from calibration.free_run import PUBLISHED, free_run
from calibration.identify import identify
from calibration.longitudinal import NotIdentifiable
from calibration.observations import CHANNELS, UNITS, Observations, observe
from calibration.parting import Parting, part
from calibration.segmenting import Cut
from calibration.standing import split_standing
from qcar_twin.bicycle import PARAMETERS, Bicycle
from qcar_twin.dataset import DataSet
from qcar_twin.plant import Prediction, Segments
from qcar_twin.recording import Recording
from qcar_twin.twin import Twin
from qcar_twin.vehicle import Vehicle
from qcar_twin.whole_file import write_json

Array = NDArray[np.float64]

WINDOWS = (0.5, 2.0, math.inf)  # s; the last is the free run
MODELS = ("twin", "bicycle")
_REGION_WINDOW = 2.0  # s, where the models part is read off these: a free run drifts through regions


@dataclasses.dataclass(frozen=True)
class Baseline:
  """The bicycle to compare with: its parameters (5,) and, in words, where they are from."""

  bicycle: Bicycle
  theta: Array
  origin: str


@dataclasses.dataclass(frozen=True)
class Score:
  """Error of one model on one channel, in `unit`; NRMSE without unit."""

  rmse: float
  nrmse: float
  samples: int
  unit: str


@dataclasses.dataclass(frozen=True, eq=False)
class Replay:
  """One window length: what was measured and predicted, value by value.

  Attributes:
    window: s; inf for the free run.
    predicted: model -> values, (M,).
  """

  window: float
  observations: Observations
  predicted: Mapping[str, Array]

  def scores(self, model: str, recording: int | None = None) -> dict[str, Score]:
    """By channel; of one recording, by its index, or of all."""
    chosen = {}
    for channel in self.observations.present:
      rows = self.observations.select(channel)
      if recording is not None:
        rows &= self.observations.recording == recording
      if rows.any():
        chosen[channel] = _score(self.predicted[model][rows], self.observations.measured[rows], UNITS[channel])
    return chosen

  @property
  def name(self) -> str:
    """The window in words."""
    return f"{self.window:g} s" if math.isfinite(self.window) else "free run"


@dataclasses.dataclass(frozen=True)
class CrossValidation:
  """Twin against bicycle against recordings.

  Attributes:
    roles: of the recordings that were predicted.
    baseline: the bicycle, or None where `missing` says why.
    replays: one per window length.
    parting: where the models part; None without a bicycle.
    ovals: recording -> model -> channel -> RMSE of the filtered free run, as the paper reports its oval.
    noise: standard deviation of each channel's sensor.
  """

  dataset: DataSet
  roles: tuple[str, ...]
  twin: Twin
  theta: Array
  baseline: Baseline | None
  missing: str
  replays: tuple[Replay, ...]
  parting: Parting | None
  ovals: Mapping[str, Mapping[str, Mapping[str, float]]]
  noise: Mapping[str, float]

  @property
  def models(self) -> tuple[str, ...]:
    return MODELS if self.baseline else MODELS[:1]

  def document(self) -> dict[str, Any]:
    """What cross_validation.json holds."""

    def table(replay: Replay, recording: int | None = None) -> dict[str, Any]:
      return {m: {c: dataclasses.asdict(s) for c, s in replay.scores(m, recording).items()} for m in self.models}

    names = self.replays[0].observations.names
    return {
      "dataset": self.dataset.name,
      "roles": list(self.roles),
      "bicycle": self.baseline and {"origin": self.baseline.origin, **PARAMETERS.named(self.baseline.theta)},
      "missing": self.missing,
      "windows": {r.name: table(r) for r in self.replays},
      "recordings": {name: {r.name: table(r, k) for r in self.replays} for k, name in enumerate(names)},
      "ovals": self.ovals,
      "published_oval": PUBLISHED,
      "parting": self.parting.document() if self.parting else None,
      "noise": self.noise,
    }

  def write(self, folder: str | os.PathLike[str]) -> Path:
    """Write cross_validation.json and report.html; returns the report's path."""
    from calibration.report.cross_validation import write_report  # the page knows this module, not the other way round

    write_json(Path(folder) / "cross_validation.json", self.document())
    return write_report(Path(folder) / "report.html", self)


def cross_validate(
  dataset: DataSet,
  twin: Twin,
  theta: Array,
  baseline: Baseline | None,
  roles: Sequence[str] = ("validate",),
  shift: int = 0,
  windows: Sequence[float] = WINDOWS,
  missing: str = "",
  progress: Callable[[str], None] = lambda text: None,
) -> CrossValidation:
  """Predict recordings of some roles with both models.

  Args:
    twin, theta: the calibrated twin and its parameters (P,). Its sensor-side mechanisms act on both models.
    baseline: the bicycle to compare with, or None, for the reason `missing`.
    roles: "validate", "holdout" (opened once, at the end); "identify" shows the fit itself.
    shift: control periods by which commands act later than logged.

  Raises:
    ValueError: no recording has one of these roles.
  """
  recordings = [r for r in dataset.recordings if r.role in roles]
  if not recordings:
    present = sorted({r.role for r in dataset.recordings})
    raise ValueError(
      f"data set '{dataset.name}' has no recording with role {' or '.join(roles)}, only {', '.join(present)};"
      " give some another role in dataset.toml, or choose the roles to look at (--roles)"
    )
  replays, parting = [], None
  for window in windows:
    progress(f"windows of {window:g} s" if math.isfinite(window) else "free run")
    replays.append(replay(twin, theta, baseline, recordings, window, shift))
  if baseline:
    progress("where the models part")
    parting = part(replay(twin, theta, baseline, recordings, _REGION_WINDOW, shift), recordings, twin.vehicle)
  ovals = {r.name: _oval(twin, theta, baseline, r) for r in recordings if r.manoeuvre == "oval"}
  noise = sensor_floor(noise_passport([r for r in dataset.recordings if r.role != "holdout"] or recordings))
  return CrossValidation(dataset, tuple(roles), twin, theta, baseline, missing, tuple(replays), parting, ovals, noise)


def find_baseline(
  dataset: DataSet, cut: Cut, progress: Callable[[str], None] = lambda text: None
) -> tuple[Baseline | None, str]:
  """The identified bicycle of a data set; where its steps don't suffice, one fitted to its recordings.

  Returns:
    the baseline, or None and the reason.
  """
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  progress("identification")
  try:
    found = identify(dataset, vehicle=vehicle)
    missing = found.missing
    if found.lateral:
      return Baseline(*found.bicycle(vehicle), "identified from voltage steps and step steers"), ""
  except NotIdentifiable as error:
    missing = str(error)
  recordings, _ = split_standing([r for r in dataset.recordings if r.role == "identify"])
  try:
    theta = fit_bicycle(recordings, vehicle, cut, progress).theta
  except ValueError as error:
    return None, f"{missing}; nor could it be fitted to the recordings: {error}"
  return Baseline(Bicycle(vehicle), theta, "fitted to the recordings with role 'identify'"), missing


def replay(
  twin: Twin, theta: Array, baseline: Baseline | None, recordings: Sequence[Recording], window: float, shift: int
) -> Replay:
  """Both models on recordings cut into windows; inf for free runs."""
  cut = Cut(length=window, warm_up=0.0, shift=shift)
  observations = observe(recordings, twin.vehicle, cut, horizon=min(1.0, 0.8 * window))
  segments = observations.stretches.segments
  predicted = {"twin": observations.predict(twin.rollout(theta, segments))[0]}
  if baseline:
    seen = as_seen(twin, theta, baseline.bicycle.rollout(baseline.theta, segments), segments)
    predicted["bicycle"] = observations.predict(seen)[0]
  return Replay(window, observations, predicted)


def as_seen(twin: Twin, theta: Array, prediction: Prediction, segments: Segments) -> Prediction:
  """A prediction (1, S, T + 1, 10) as the sensors of a twin with parameters (P,) show it: biases, latencies."""
  signals = prediction.signals[0].copy()
  twin.measured(np.tile(theta, (len(segments), 1)), signals, segments.offset)
  return Prediction(signals[None], prediction.period)


def _score(predicted: Array, measured: Array, unit: str) -> Score:
  rmse = float(np.sqrt(np.mean(np.square(predicted - measured))))
  spread = float(np.std(measured))
  return Score(rmse, rmse / spread if spread > 0.0 else math.nan, len(measured), unit)


def _oval(twin: Twin, theta: Array, baseline: Baseline | None, recording: Recording) -> dict[str, dict[str, float]]:
  found = {"twin": free_run(twin, theta, recording, twin.vehicle).rmse}
  if baseline:
    found["bicycle"] = free_run(baseline.bicycle, baseline.theta, recording, twin.vehicle).rmse
  return found


def ordered(channels: Sequence[str]) -> list[str]:
  """Channels in the order of CHANNELS."""
  return [name for name in CHANNELS if name in channels]
