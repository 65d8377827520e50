"""What every fit begins with: the log checked, its roles seen to, what must be said of both, and ages of sensors.

Only differences of ages show. One sensor is the clock therefore, the pose where there is one, and all else is late or
early against it; for fits the one that speaks first is.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibration.fitting.coverage import with_coverage
from calibration.fitting.dataset_recalibration import LONGEST, left_out
from calibration.fitting.noise import noise_models
from calibration.log_check.check import heed
from calibration.log_check.motions import Wheels, motions
from calibration.log_check.pairs import Estimate, compare
from qcar_twin.recordings.checks.steered import along_only, turns_unsteered
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.mechanisms.accel_bias import LEANS
from qcar_twin.vehicle.vehicle import Vehicle

_FINEST = 0.005  # s, and share of a scale: closer than that sensors are not said to agree, wheels slip and bodies roll
_SHOWN_BY = {"turning": ("imu_latency", "gyro_scale"), "driving": ("encoder_latency", None)}
_FELT = {"speeding up and slowing down": "accel_scale_x", "going round": "accel_scale_y"}


def ready(dataset: DataSet, most: float = LONGEST, evenly: bool = False) -> tuple[DataSet, tuple[str, ...]]:
  """The data set with the roles that are used, and sentences about sensors that disagree, roles, and what is left out.

  Of a car that turned with no steering command in its log, what shows turning is left out: the twin drives straight on.

  Args:
    most: s of driving that will be simulated.
    evenly: it is spread evenly; else half of it is chosen for what it tells.

  Raises:
    RecordingError: two sensors contradict each other.
  """
  checked = heed(dataset)
  if turns_unsteered([r for r in dataset.recordings if r.role != "holdout"]):
    dataset = dataclasses.replace(dataset, recordings=tuple(along_only(dataset.recordings)))
  dataset, joined = with_coverage(dataset)
  return dataset, (*checked, *joined, *left_out(dataset, most, evenly))


def clock(recordings: Sequence[Recording]) -> str:
  """The age that counts as zero."""
  return "pose_latency" if any("pose_x" in r for r in recordings) else "encoder_latency"


def fitted_ages(dataset: DataSet, vehicle: Vehicle) -> dict[str, tuple[float, float]]:
  """What `told_without_a_model` says of the recordings that are fitted or judge a fit, counted from what speaks first.

  No sensor shows a motion before it is one. Where another speaks before the pose the pose is late, and what else was
  counted from it is as much later.
  """
  told = told_without_a_model([r for r in dataset.recordings if r.role != "holdout"], vehicle)
  ages = {age: told[age] for age, _ in _SHOWN_BY.values() if age in told}
  first = min(ages, key=lambda age: ages[age][0], default=None)
  if first is None or ages[first][0] >= 0.0:
    return told
  early, std = told.pop(first)
  later = {age: (told[age][0] - early, told[age][1]) for age in ages if age != first}
  return told | later | {clock(dataset.recordings): (-early, std)}


def told_without_a_model(recordings: Sequence[Recording], vehicle: Vehicle) -> dict[str, tuple[float, float]]:
  """Ages [s] and scales [-] of sensors, with deviations, from geometry alone: parameter -> both.

  A deviation counts twice, for what geometry leaves out. No ages without a pose, and no encoder that is early: wheels
  slip in proportion to the acceleration, which looks like a lead by m v / C_x, 6 ms of a QCar, 18 on softer tyres; nor
  of an encoder where the pose gave the speed. An
  accelerometer's scale is told only where it is off by more than a body that leans explains.
  """
  wheels, noise, told = Wheels.of(vehicle, recordings), noise_models(recordings), {}
  by_sensor = not any(wheels.channel in r.derived for r in recordings)
  aged = {name for name in _SHOWN_BY if clock(recordings) == "pose_latency" and (by_sensor or name != "driving")}
  shown = _FELT.keys() | aged
  for motion in motions(wheels, recordings):
    if motion.name not in shown or (seen := compare(motion, wheels, recordings, noise)).why_not:
      continue
    if motion.name in _FELT:
      felt = Estimate(seen.scale.value, float(np.hypot(2.0 * seen.scale.std, LEANS)))
      if felt.beyond(1.0):
        told[_FELT[motion.name]] = (felt.value - 1.0, felt.std)
      continue
    age, scale = _SHOWN_BY[motion.name]
    if motion.name == "driving" and seen.lag.value < 0.0:
      continue
    told[age] = (seen.lag.value, max(2.0 * seen.lag.std, _FINEST))
    if scale:
      told[scale] = (seen.scale.value - 1.0, max(2.0 * seen.scale.std, _FINEST))
  return {name: (value, std) for name, (value, std) in told.items() if np.isfinite(value + std)}
