"""The paper's identification of the bicycle model: data set in, five parameters with deviations out.

  identification = identify(dataset)
  print(identification)
  bicycle, theta = identification.bicycle(vehicle)

Longitudinal part in `longitudinal`, lateral part in `lateral`, errors as the paper means them: root mean
square over the trajectory of a step response, per cent of its measured steady value, averaged over the steps.
Recordings with role "holdout" are not looked at.
"""

import dataclasses
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from calibration.identification.drive_fit import DriveFit, NotIdentifiable, StepError, fit_drive
from calibration.identification.steering_steps import find_turns, turning_drag
from calibration.identification.tyre_fit import LateralFit, fit_lateral
from calibration.identification.understeer import Understeer, understeer_characteristic
from qcar_twin.atomic_io import write_json
from qcar_twin.bicycle.bicycle import PARAMETERS, Bicycle, MeasuredCar, TurningLosses, drive_of, parameters_of
from qcar_twin.kinematics import rolling_radius
from qcar_twin.parameters import ParameterSet
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.untrusted import UnreadableFile, read_json
from qcar_twin.vehicle.drive import DRIVES
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
SteadyState = Literal["exact", "paper"]
Transient = Literal["lagged", "linear"]


@dataclasses.dataclass(frozen=True)
class Identification:
  """Outcome of `identify`.

  Attributes:
    dataset: name of the data set.  steady_state: "exact" or "paper".  transient: "lagged" or "linear".
    drive, lateral: fits; lateral is None where `missing` says why.
    understeer: characteristic of a ramp steer, if there was one.
    turning_drag, turning_drag_std: of `TurningLosses`, rad/s^2 per rad^2; NaN if not fitted.
    command: channel of the drive's command, in whose unit P1 and the levels of its steps are.
  """

  dataset: str
  steady_state: str
  transient: str
  drive: DriveFit
  lateral: LateralFit | None
  missing: str
  understeer: Understeer | None
  turning_drag: float = math.nan
  turning_drag_std: float = math.nan
  command: str = DRIVES["voltage"].channel

  @property
  def parameters(self) -> ParameterSet:
    """Declarations of the five for the drive that was identified."""
    return parameters_of(next(drive for drive in DRIVES.values() if drive.channel == self.command))

  @property
  def theta(self) -> Array:
    """Parameters in the order of `bicycle.PARAMETERS`, (5,); nominal stiffness where none was identified."""
    lateral = self.lateral.values if self.lateral else PARAMETERS.nominal[3:]
    return np.array([*self.drive.values, *lateral])

  @property
  def covariance(self) -> Array:
    """Of theta, (5, 5); drive and tyres come from different recordings. NaN where unknown."""
    result = np.zeros((5, 5))
    result[:3, :3] = self.drive.covariance
    result[3:, 3:] = self.lateral.covariance if self.lateral else np.full((2, 2), np.nan)
    return result

  @property
  def std(self) -> Array:
    """Standard deviations of theta, (5,)."""
    return np.sqrt(np.diag(self.covariance))

  @property
  def losses(self) -> TurningLosses:
    """What turning takes beyond the paper's model, as far as it was identified."""
    steering = self.lateral.steering_loss if self.lateral else math.nan
    return TurningLosses(*(x if math.isfinite(x) else 0.0 for x in (steering, self.turning_drag)))

  def bicycle(self, vehicle: MeasuredCar, period: float = 0.01, losses: bool = False) -> tuple[Bicycle, Array]:
    """The identified plant and its parameters (5,); the paper's, or with the identified turning losses."""
    bicycle = Bicycle(vehicle, period, self.losses if losses else TurningLosses())
    values = self.theta if self.lateral else np.array([*self.drive.values, *bicycle.parameters.nominal[3:]])
    return bicycle, values

  def rmse_percent(self, part: str, role: str) -> float:
    """Average RMSE of step responses, per cent: part "longitudinal", "lateral" or "yaw_rate"; NaN if there are none."""
    return _mean_percent(self._steps(part), role)

  def steady_error(self, part: str, role: str) -> float:
    """Largest steady-state error in the unit of the response (rad/s, m/s^2, rad/s); NaN if there are none."""
    errors = [abs(s.measured - s.model) for s in self._steps(part) if s.role == role]
    return float(np.nanmax(errors)) if np.any(np.isfinite(errors)) else math.nan

  def _steps(self, part: str) -> tuple[StepError, ...]:
    if part == "longitudinal":
      return self.drive.steps
    if part not in ("lateral", "yaw_rate"):
      raise ValueError(f"no part '{part}'; there are longitudinal, lateral, yaw_rate")
    if self.lateral is None:
      return ()
    return self.lateral.steps if part == "lateral" else self.lateral.yaw_rate_steps

  def __str__(self) -> str:
    return "\n".join(
      [
        f"{self.dataset}: bicycle identified, steady state '{self.steady_state}', {self.transient} transient",
        *_table(self),
      ]
    )

  def save(self, path: str | os.PathLike[str]) -> Path:
    """Write as JSON, whole or not at all; unknown numbers are null."""
    return write_json(path, dataclasses.asdict(self))

  @classmethod
  def load(cls, path: str | os.PathLike[str]) -> "Identification":
    """Read what `save` wrote. Raises ValueError that names the file if it is something else."""
    try:
      identification = _read(cls, read_json(path))
      if not np.isfinite(np.asarray(identification.theta, dtype=float)).all():
        raise ValueError("a parameter has no finite value")
      return identification
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
      raise UnreadableFile(
        f"{Path(path).name} is no identification ({error}); write it with Identification.save"
      ) from error


def identify(
  dataset: DataSet,
  steady_state: SteadyState = "exact",
  transient: Transient | None = None,
  vehicle: MeasuredCar | None = None,
) -> Identification:
  """Two-stage least squares on the steps of the drive command and step steers of a data set.

  Args:
    steady_state: "exact", or "paper" for the printed understeer gradient.
    transient: "lagged", or "linear" for the printed cost; by default the one that goes with the steady state.
    vehicle: measured numbers; those of the data set if None.

  Raises:
    NotIdentifiable: the drive can't be identified. Tyres that can't be leave `lateral` None.
  """
  if steady_state not in ("exact", "paper"):
    raise ValueError(f"steady_state must be 'exact' or 'paper', not '{steady_state}'")
  transient = transient or ("lagged" if steady_state == "exact" else "linear")
  if transient not in ("lagged", "linear") or (steady_state == "paper" and transient == "lagged"):
    raise ValueError(f"transient must be 'linear', or 'lagged' with steady_state='exact', not '{transient}'")
  car: MeasuredCar = vehicle or Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  recordings = [r for r in dataset.recordings if r.role != "holdout"]
  std = dict(dataset.vehicle_std)
  scale_std = math.hypot(std.get("gear_ratio", 0.0) / car.gear_ratio, std.get("wheel_radius", 0.0) / car.wheel_radius)
  drive = fit_drive(recordings, rolling_radius(car), scale_std, drive_of(car))
  lateral, missing, drag = None, "", (math.nan, math.nan)
  try:
    lateral = fit_lateral(recordings, car, std, steady_state, transient)
    turns = [t for t in find_turns(recordings, car) if t.step.role == "identify" and t.step.steady is not None]
    drag = turning_drag(turns, drive.values, car)
  except NotIdentifiable as error:
    missing = str(error)
  understeer = understeer_characteristic(recordings, car)
  command = drive_of(car).channel
  return Identification(dataset.name, steady_state, transient, drive, lateral, missing, understeer, *drag, command)


def _mean_percent(steps: Iterable[StepError], role: str) -> float:
  values = [s.rmse_percent for s in steps if s.role == role]
  return float(np.mean(values)) if values else math.nan


def _table(identification: Identification) -> list[str]:
  rows = []
  for parameter, value, std in zip(identification.parameters, identification.theta, identification.std, strict=True):
    known = identification.lateral is not None or not parameter.name.startswith("cornering")
    shown = f"{value:10.4g} +- {std:<9.3g}" if known else f"{'not identified':>23} "
    rows.append(f"  {parameter.symbol:4s} {parameter.name:26s} {shown} {parameter.unit}")
  for part, unit in (("longitudinal", "rad/s"), ("lateral", "m/s^2"), ("yaw_rate", "rad/s")):
    for role in ("identify", "validate"):
      percent = identification.rmse_percent(part, role)
      if math.isfinite(percent):
        steady = identification.steady_error(part, role)
        rows.append(f"  {part:13s} {role:9s} RMSE {percent:6.2f} %   steady state within {steady:.3g} {unit}")
  lateral = identification.lateral
  if lateral is not None:
    rows.append(
      f"  understeer gradient {lateral.understeer_gradient:.3g} rad s^2/m at {lateral.speed:.3g} m/s;"
      f" the printed k_su is off by {lateral.printed_error_percent:+.2f} %"
    )
  if identification.losses != TurningLosses():
    steering, std = (
      identification.losses.steering,
      identification.lateral.steering_loss_std if identification.lateral else math.nan,
    )
    rows.append(
      f"  beyond the paper, in turns: steering loss {steering:.2f} +- {std:.2f} 1/rad^2,"
      f" drag {identification.turning_drag:.0f} +- {identification.turning_drag_std:.0f} rad/s^2 per rad^2"
    )
  if identification.understeer is not None:
    rows.append(
      f"  linear up to {identification.understeer.linear_limit:.2g} m/s^2 of lateral acceleration (ramp steer)"
    )
  notes = identification.drive.notes + (
    identification.lateral.notes if identification.lateral else (f"tyres: {identification.missing}",)
  )
  return rows + [f"  note: {note}" for note in notes]


def _number(value: Any) -> Any:
  """JSON back to Python: null is an unknown number, lists are tuples."""
  if isinstance(value, list):
    return tuple(_number(item) for item in value)
  if isinstance(value, dict):
    return {key: _number(item) for key, item in value.items()}
  return math.nan if value is None else value


def _read(cls: type[Identification], raw: dict[str, Any]) -> Identification:
  def steps(items: list[dict[str, Any]]) -> tuple[StepError, ...]:
    return tuple(StepError(**_number(item)) for item in items)

  drive = DriveFit(**{**_number(raw["drive"]), "steps": steps(raw["drive"]["steps"])})
  lateral = understeer = None
  if raw["lateral"] is not None:
    errors = {name: steps(raw["lateral"][name]) for name in ("steps", "yaw_rate_steps")}
    lateral = LateralFit(**{**_number(raw["lateral"]), **errors})
  if raw["understeer"] is not None:
    understeer = Understeer(**_number(raw["understeer"]))
  drag = (_number(raw[name]) for name in ("turning_drag", "turning_drag_std"))
  said = {"command": str(raw["command"])} if "command" in raw else {}  # files without it are of a voltage
  return cls(
    raw["dataset"], raw["steady_state"], raw["transient"], drive, lateral, raw["missing"], understeer, *drag, **said
  )
