"""First values of the drive's parameters, straight from the log, so that a fit starts in the right valley.

The motor's equation omega' = P1 V - P2 omega - P3 sgn(omega), V the drive's command in its unit, integrated over
windows so that no signal is differentiated, is solved for V and fitted by a robust regression. Solved for omega' it
would be satisfied by P1 = P2 = P3 = 0 wherever the speed is steady, so that steady driving with a loss that the
equation lacks (a turn) shrinks all three. What no regression gives is tried: tyres of a few stiffnesses, and starts on
other sides of what makes a cost rough.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from calibration.fitting.likelihood import Problem, flat_weighting
from calibration.fitting.observations import Observations
from calibration.fitting.optimiser import prior_cost
from calibration.fitting.windows import driven
from qcar_twin.kinematics import motor_speed
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.parameters import base_parameters, drive_response, drive_values, informed
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

# of the nominal friction, where rough fits begin: from above the wheels hold and the cost is smooth
_GRIPS = (1.0, 1.4)
# wheels that steer in parallel and wheels aimed at the turning centre: between them a car's tyres make up for either
_LINKAGES = (0.0, 1.0)
_WINDOW = 0.4  # s over which the equation is integrated
_PERIOD = 0.02  # s
_LIGHTEST = 0.01  # of the usual inertia over torque, a stated prior: no car has less, and the law damps nothing
_BODY = ("mass", "yaw_inertia", "cg_to_front", "cg_height_offset")
_HELD = 0.01  # of a limit, its deviation where it is held
_TRIED = 8  # values of a limit between none and its bound
_SHOWN = 3.0  # deviations from nothing, from which a lag of the drive is told


def first_guess(recordings: Sequence[Recording], vehicle: Vehicle) -> ParameterSet:
  """Base parameters of the twin with drive values read off the recordings; nominal ones if that fails."""
  base = base_parameters(vehicle)
  rows = [_integrals(r, vehicle) for r in recordings]
  table = np.concatenate([r for r in rows if len(r)] or [np.zeros((0, 4))])
  if len(table) < 20:
    return base
  p1, p2, p3 = _with_shown_lag(_regression(table), drive_response(vehicle, base), _interval(recordings))
  values = drive_values(vehicle, p1, p2, p3)
  if vehicle.drive == "speed":  # its loop's integral part takes the friction over: the log shows none to begin with
    del values["driveline_friction"]
  return informed(base, values)


def best_start(twin: Twin, observations: Observations, n_train: int, base: ParameterSet) -> Array:
  """The best of a few guesses that differ in tyre stiffness; the drive's come from the log."""
  problem = Problem(twin, observations, flat_weighting(observations), n_train)
  guesses = []
  for stiffness in (0.6, 1.6):
    guess = base.start
    for name in ("cornering_stiffness_front", "cornering_stiffness_rear"):
      guess[base.index(name)] *= stiffness
    guesses.append(np.clip(guess, base.lower, base.upper))
  guesses.append(base.start)
  residual = problem.fitted_residual(problem.embed(base.names, np.stack(guesses), twin.parameters.nominal))
  return guesses[int(np.argmin(np.sum(np.abs(residual), axis=1)))]


def varied_starts(base: ParameterSet, theta: Array) -> list[Array]:
  """Estimates with shares of the nominal friction coefficient and with other Ackermann fractions."""
  out = []
  for grip, linkage in itertools.product(_GRIPS, _LINKAGES):
    start = theta.copy()
    values = {"friction_coefficient": grip * base["friction_coefficient"].nominal, "ackermann_fraction": linkage}
    for name, value in values.items():
      i = base.index(name)
      start[i] = np.clip(value, base.lower[i], base.upper[i])
    out.append(start)
  return out


def held_close(base: ParameterSet) -> ParameterSet:
  """The same with what was weighed and measured held ten times closer, and limits where they act.

  A wheel that slides hard in the wrong twin makes the cost so rough that a fit of everything ends where a false
  centre of gravity makes up for a false grip, thousands of nats above the minimum. A limit that no longer acts has no
  slope: one that a poor twin drove there stays there.
  """
  measured = {n: dataclasses.replace(base[n], std=0.1 * (base[n].std or 0.0)) for n in _BODY if base[n].std}
  acting = {
    p.name: dataclasses.replace(p, nominal=p.start, std=_HELD * p.start, start=None) for p in _limits(base) if p.start
  }
  return base.replace(**measured, **acting)


def _limits(base: ParameterSet) -> list[Parameter]:
  """Parameters that do nothing below a size that the driving decides, where a search begins elsewhere than at none."""
  return [p for p in base if p.start is not None and p.nominal == p.null]


def where_limits_act(problem: Problem, base: ParameterSet, theta: Array, worth: float) -> Array | None:
  """Estimates with limits where they explain most, (p,), all else as it is; None where that gains less than `worth`,
  nats.

  A limit that is not reached has no slope, and a fit that once left it does not come back: a servo that runs at its
  highest rate in steps, fitted from a rate that they do not reach, ends as a slow one without a limit.
  """

  def costs_of(tried: Array) -> Array:
    residual = problem.fitted_residual(problem.embed(base.names, tried, problem.parameters.nominal))
    costs = 0.5 * np.sum(residual**2, axis=1) + [prior_cost(one, base) for one in tried]
    return np.where(np.isfinite(costs), costs, np.inf)

  begun, cost = theta, float(costs_of(theta[None])[0])
  for p in _limits(base):
    tried = np.repeat(begun[None], _TRIED, axis=0)
    tried[:, base.index(p.name)] = np.linspace(p.lower, p.upper, _TRIED + 1)[1:]
    costs = costs_of(tried)
    if np.min(costs) < cost - worth:
      begun, cost = tried[int(np.argmin(costs))], float(np.min(costs))
  return None if begun is theta else begun


def _integrals(recording: Recording, vehicle: Vehicle) -> Array:
  """Rows of change of motor speed, integral of V, of omega, of sgn(omega) over windows, (k, 4)."""
  name = next((n for n in ("motor_speed", "speed") if n in recording.channels), None)
  if name is None or recording.duration < 2 * _WINDOW:
    return np.zeros((0, 4))
  stream = recording[name]
  time, commands = driven(recording, vehicle, _PERIOD)
  speed = np.interp(time, stream.time, stream.value)
  if name == "speed":
    speed = motor_speed(speed, vehicle)
  width = int(_WINDOW / _PERIOD)
  total = lambda x: np.concatenate([[0.0], np.cumsum(x)]) * _PERIOD
  sign = np.tanh(speed / 5.0)
  parts = [total(commands[:, 0]), total(speed), total(sign)]
  starts = np.arange(0, len(time) - width - 1, width // 2)
  change = speed[starts + width] - speed[starts]
  rows = np.column_stack([change, *[p[starts + width] - p[starts] for p in parts]])
  return rows[np.abs(rows[:, 3]) > 0.9 * _WINDOW]  # windows in which the car rolls one way


def _interval(recordings: Sequence[Recording]) -> float:
  """Usual time between two samples of a speed, s; 0 without any."""
  streams = [r[n] for r in recordings for n in ("motor_speed", "speed") if n in r and len(r[n]) > 1]
  return float(np.median(np.concatenate([np.diff(s.time) for s in streams]))) if streams else 0.0


def _with_shown_lag(
  law: tuple[Array, float], usual: tuple[float, float, float], interval: float
) -> tuple[float, float, float]:
  """P1, P2 and P3 from V = a omega' + b omega + c sgn(omega) and the deviation of a; not finite where nothing is shown.

  A drive that answers within a sample of a slow log shows b and c alone, and an a of nothing is a motor without
  inertia. It then has the time constant of the `usual` P1, P2 and P3, a / b = 1 / P2, or their 1 / P1 where nothing
  damps it, as where a current drives. So it has where a / b is less than half the `interval` between samples, s: that
  is what lies between them.
  """
  (a, b, c), std = law
  if not np.isfinite(a):
    return np.inf, np.inf, np.inf
  gain, damping, _ = usual
  if a < max(_SHOWN * std, 0.5 * interval * b):
    a = max(a, b / damping)
    a = a if a * gain > _LIGHTEST else 1.0 / gain
  return 1.0 / a, b / a, c / a


def _regression(table: Array) -> tuple[Array, float]:
  """a, b, c >= 0 of V = a omega' + b omega + c sgn(omega), with two rounds of Huber weights, and a's deviation.

  Not finite where the speed never changes: then nothing shows them. Of neighbouring windows, which share half of what
  they saw, every other one is a witness.
  """
  matrix, volts = table[:, [0, 2, 3]], table[:, 1]
  if not np.any(matrix[:, 0]):
    return np.full(3, np.inf), np.inf
  weight = np.ones(len(table))
  solution = np.ones(3)
  for _ in range(3):
    scale = np.abs(matrix).max(axis=0) + 1e-12
    fit = lsq_linear(matrix / scale * weight[:, None], volts * weight, bounds=(0.0, np.inf))
    solution = fit.x / scale
    error = np.abs(volts - matrix @ solution)
    weight = np.sqrt(1.0 / np.maximum(1.0, error / (2.0 * np.median(error) + 1e-9)))
  scaled = matrix / scale * weight[:, None]
  left = float(np.sum((error * weight) ** 2)) / max(len(table) - 3, 1)
  std = np.sqrt(2.0 * left * np.linalg.pinv(scaled.T @ scaled)[0, 0]) / scale[0]
  return solution, float(std)
