"""The recalibrated twin of a data set: what calibration and diagnosis both start from."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.first_guess import first_guess
from calibration.fitting.recalibration import RecalibratedTwin, begun, recalibrate
from calibration.fitting.tolerances import with_sensor_biases, with_tolerances
from calibration.fitting.windows import Cut
from calibration.progress import Progress, silent
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.parameters import informed
from qcar_twin.twin.twin import Twin

Start = tuple[Twin, NDArray[np.float64]]
LONGEST = 420.0  # s of driving that are simulated; see windows.Cut
SHIFTS = (-1, 0, 1)  # control periods, where the log's timing convention is unknown


def recalibrate_dataset(
  dataset: DataSet,
  twin: Twin,
  start: Start | None = None,
  added: Sequence[Parameter] = (),
  most: float = LONGEST,
  progress: Progress = silent,
  evenly: bool = False,
  ages: Mapping[str, tuple[float, float]] | None = None,
) -> RecalibratedTwin:
  """The base parameters of a twin, and the small errors every car and sensor has, fitted to a data set.

  Args:
    dataset: recordings with roles, see `with_coverage`; role "holdout" stays closed.
    twin: the car, with the sensors' errors and tolerances among its mechanisms and any others at their null.
    start: a twin to go on from, with its parameters: the first guess.
    added: parameters of mechanisms this car is known to need, fitted with the rest.
    most: s of driving that are simulated.
    progress: reports what is being done.
    evenly: it is spread evenly; else half of it is chosen for what it tells.
    ages: of sensors, s, and scales, -, with standard deviations, as geometry tells them; see log_check/ready.py.
  """
  recordings = [r for r in dataset.recordings if r.role != "holdout"]
  priors = _aged(starting_priors(recordings, twin, start), twin.parameters, ages)
  priors = ParameterSet([p for p in priors if p.name not in {a.name for a in added}]) + added
  at = begun(twin, recordings, priors, command_shifts(dataset), Cut(most=most, evenly=evenly), progress)
  return recalibrate(at, progress)


def _aged(priors: ParameterSet, declared: ParameterSet, ages: Mapping[str, tuple[float, float]] | None) -> ParameterSet:
  """The same with the ages and scales of sensors that geometry tells: they are read off the log and need no model of a
  car. One outside the bounds of what is tolerated has those that its mechanism declares."""
  aged = {}
  for name, (value, std) in (ages or {}).items():
    if name in priors:
      prior = priors[name]
      bounds = prior if prior.lower <= value <= prior.upper else declared[name]
      nominal = float(np.clip(value, bounds.lower, bounds.upper))
      aged[name] = dataclasses.replace(prior, nominal=nominal, std=std, lower=bounds.lower, upper=bounds.upper)
  return priors.replace(**aged)


def left_out(dataset: DataSet, most: float = LONGEST, evenly: bool = False) -> tuple[str, ...]:
  """A sentence about what of a long data set is not simulated; none of a short one."""
  driven = sum(r.duration for r in dataset.recordings if r.role != "holdout")
  if driven <= most:
    return ()
  how = "spread evenly" if evenly else "half of them spread evenly and half chosen for what they tell"
  return (f"{most:g} s of {driven:.0f} s of driving are simulated, {how}; {driven - most:.0f} s are left out",)


def command_shifts(dataset: DataSet) -> tuple[int, ...]:
  """Command timings to try, control periods."""
  return SHIFTS if dataset.command_timing == "unknown" else (0,)


def starting_priors(recordings: Sequence[Recording], twin: Twin, start: Start | None) -> ParameterSet:
  """What every model fits: the base, the sensors' own small errors, and what the twin to go on from has beyond them."""
  base = first_guess(recordings, twin.vehicle)
  if start is None:
    return with_tolerances(with_sensor_biases(base, twin, recordings), twin, recordings)
  values = start[0].parameters.named(start[1])
  ruled = with_tolerances(ParameterSet(()), twin, recordings)
  small = {p.name for p in ruled if p.lower <= values.get(p.name, 0.0) <= p.upper}
  carried = [p for m in start[0].mechanisms if not m.sensor_errors for p in m.parameters if p.name not in small]
  base = informed(base, {name: values[name] for name in base.names if name in values})
  priors = with_sensor_biases(base, twin, recordings) + [
    dataclasses.replace(p, nominal=values[p.name]) for p in carried
  ]
  return with_tolerances(priors, twin, recordings)
