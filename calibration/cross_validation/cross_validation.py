"""Cross-validation: twin and bicycle against recordings that took no part in their fits.

  result = cross_validate(dataset, twin, theta, reference)
  write_cross_validation(result, "out/cross_validation")

Windows of 0.5 s and 2 s are restarted from what was measured, a free run never is. RMSE is in the channel's
unit; NRMSE is RMSE over the standard deviation of what was measured: 1 is no better than the mean. Displacements
(pose_forward, pose_left, pose_turn) are over 1 s, over 0.4 s in windows of 0.5 s.
"""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.cross_validation.bicycle_fit import fit_bicycle
from calibration.cross_validation.free_run import PUBLISHED, free_run
from calibration.cross_validation.model_difference import ModelDifference, compare_by_region
from calibration.cross_validation.replay import ReferenceBicycle, Replay, as_seen, replay
from calibration.fitting.informative import split_standing
from calibration.fitting.noise import noise_models
from calibration.fitting.noise_floor import sensor_floor
from calibration.fitting.observations import CHANNELS
from calibration.fitting.windows import Cut
from calibration.identification.drive_fit import NotIdentifiable
from calibration.identification.identification import identify
from calibration.progress import Progress, silent
from qcar_twin.bicycle.bicycle import PARAMETERS, Bicycle
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

WINDOWS = (0.5, 2.0, math.inf)  # s; the last is the free run
MODELS = ("twin", "bicycle")
_REGION_WINDOW = 2.0  # s, where the models part is read off these: a free run drifts through regions


@dataclasses.dataclass(frozen=True)
class CrossValidation:
  """Twin against bicycle against recordings.

  Attributes:
    roles: of the recordings that were predicted.
    reference: the bicycle, or None where `missing` says why.
    replays: one per window length.
    difference: where the models part; None without a bicycle.
    ovals: recording -> model -> channel -> RMSE of the filtered free run, as the paper reports its oval.
    noise: standard deviation of each channel's sensor.
  """

  dataset: DataSet
  roles: tuple[str, ...]
  twin: Twin
  theta: Array
  reference: ReferenceBicycle | None
  missing: str
  replays: tuple[Replay, ...]
  difference: ModelDifference | None
  ovals: Mapping[str, Mapping[str, Mapping[str, float]]]
  noise: Mapping[str, float]

  @property
  def models(self) -> tuple[str, ...]:
    return MODELS if self.reference else MODELS[:1]

  def document(self) -> dict[str, Any]:
    """What cross_validation.json holds."""

    def table(replay: Replay, recording: int | None = None) -> dict[str, Any]:
      return {m: {c: dataclasses.asdict(s) for c, s in replay.scores(m, recording).items()} for m in self.models}

    names = self.replays[0].observations.names
    return {
      "dataset": self.dataset.name,
      "roles": list(self.roles),
      "bicycle": self.reference and {"origin": self.reference.origin, **PARAMETERS.named(self.reference.theta)},
      "missing": self.missing,
      "windows": {r.name: table(r) for r in self.replays},
      "recordings": {name: {r.name: table(r, k) for r in self.replays} for k, name in enumerate(names)},
      "ovals": self.ovals,
      "published_oval": PUBLISHED,
      "difference": self.difference.document() if self.difference else None,
      "noise": self.noise,
    }


def with_roles(dataset: DataSet, roles: Sequence[str]) -> list[Recording]:
  """Recordings of some roles. Raises ValueError where there are none."""
  recordings = [r for r in dataset.recordings if r.role in roles]
  if not recordings:
    present = sorted({r.role for r in dataset.recordings})
    raise ValueError(
      f"data set '{dataset.name}' has no recording with role {' or '.join(roles)}, only {', '.join(present)};"
      " give some another role in dataset.toml, or choose the roles to look at (--roles)"
    )
  return recordings


def cross_validate(
  dataset: DataSet,
  twin: Twin,
  theta: Array,
  reference: ReferenceBicycle | None,
  roles: Sequence[str] = ("validate",),
  command_shift: int = 0,
  windows: Sequence[float] = WINDOWS,
  missing: str = "",
  progress: Progress = silent,
) -> CrossValidation:
  """Predict recordings of some roles with both models.

  Args:
    twin, theta: the calibrated twin and its parameters (P,). Its sensor-side mechanisms act on both models.
    reference: the bicycle to compare with, or None, for the reason `missing`.
    roles: "validate", "holdout" (opened once, at the end); "identify" shows the fit itself.
    command_shift: control periods by which commands act later than logged.

  Raises:
    ValueError: no recording has one of these roles.
  """
  recordings = with_roles(dataset, roles)
  replays, difference = [], None
  for window in windows:
    progress(f"windows of {window:g} s" if math.isfinite(window) else "free run")
    replays.append(replay(twin, theta, reference, recordings, window, command_shift))
  if reference:
    progress("where the models part")
    difference = compare_by_region(
      replay(twin, theta, reference, recordings, _REGION_WINDOW, command_shift), recordings, twin.vehicle
    )
  ovals = {r.name: _oval(twin, theta, reference, r, command_shift) for r in recordings if r.manoeuvre == "oval"}
  noise = sensor_floor(noise_models([r for r in dataset.recordings if r.role != "holdout"] or recordings))
  return CrossValidation(
    dataset, tuple(roles), twin, theta, reference, missing, tuple(replays), difference, ovals, noise
  )


def find_reference(dataset: DataSet, cut: Cut, progress: Progress = silent) -> tuple[ReferenceBicycle | None, str]:
  """The identified bicycle of a data set; where its steps don't suffice, one fitted to its recordings.

  Returns:
    the reference, or None and the reason.
  """
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  progress("identification")
  try:
    identification = identify(dataset, vehicle=vehicle)
    missing = identification.missing
    if identification.lateral:
      return ReferenceBicycle(*identification.bicycle(vehicle), "identified from steps of drive and steering"), ""
  except NotIdentifiable as error:
    missing = str(error)
  recordings, _ = split_standing([r for r in dataset.recordings if r.role == "identify"])
  try:
    theta = fit_bicycle(recordings, vehicle, cut, progress).theta
  except ValueError as error:
    return None, f"{missing}; nor could it be fitted to the recordings: {error}"
  return ReferenceBicycle(Bicycle(vehicle), theta, "fitted to the recordings with role 'identify'"), missing


def _oval(
  twin: Twin, theta: Array, reference: ReferenceBicycle | None, recording: Recording, command_shift: int
) -> dict[str, dict[str, float]]:
  rmse = {"twin": free_run(twin, theta, recording, twin.vehicle, command_shift).rmse}
  if reference:
    seen = functools.partial(as_seen, twin, theta)
    rmse["bicycle"] = free_run(reference.bicycle, reference.theta, recording, twin.vehicle, command_shift, seen).rmse
  return rmse


def ordered(channels: Sequence[str]) -> list[str]:
  """Channels in the order of CHANNELS."""
  return [name for name in CHANNELS if name in channels]
