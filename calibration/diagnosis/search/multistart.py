"""Effects that recalibration bends out of shape around.

A delay of 0.2 s is no small change of a twin whose tyres went soft to imitate it: seen from there, its signature is
another one, and a refit from there ends in a minimum of its own.
So mechanisms are also tried on parameters that recalibration has not bent: delays and lags at up to several times
their typical size on the first guess of everything, and all of them on the recalibrated twin with
the measured parameters put back that were moved beyond belief: those of the drive for mechanisms that push along, the
others for all others. Where that explains much, the whole model is fitted from there. So is what all sensors' ages
have in common, put on a delay of the commands: between the two a cost has a valley for every control period.
"""

import dataclasses
import math
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from calibration.diagnosis.candidates import Candidate, begin, candidate, half_square, refine
from calibration.diagnosis.scan import measured, trial_starts, varied
from calibration.fitting.likelihood import Problem
from calibration.fitting.optimiser import prior_cost
from qcar_twin.parameters import ParameterSet
from qcar_twin.twin.mechanisms import by_subsystem
from qcar_twin.vehicle.drive import DRIVES

# of the typical size: of delays on the first guess, of those and of likely ones on the unbent twin, and of all others
# there
_LARGE, _USUAL, _WHOLE = (1.0, 2.5, 5.0), (0.6, 1.3), (1.0,)
# the motor's torque per command in any of its kinds, and what else moves the car along
_DRIVE = frozenset(motor.gain for motor in DRIVES.values()) | {
  "motor_damping", "driveline_friction", "rotor_inertia", "longitudinal_stiffness",
}  # fmt: skip
_BENT = 2.0  # prior standard deviations beyond which a parameter is put back
_WORTH = 30.0  # nats a trial must bring to the twin it is tried on
_RIVALS = 3.0  # and how far above the recalibrated twin's cost it may lie
_MOST = 2  # mechanisms that are fitted
_STEPS = 5


@dataclasses.dataclass(frozen=True)
class _Place:
  """Base values, by name, and what to try there: (mechanism, parameter values)."""

  values: Mapping[str, float]
  trials: Sequence[tuple[str, dict[str, float]]]


def multistart_models(
  problem: Problem, base: Candidate, priors: ParameterSet, considered: Sequence[str], likely: Sequence[str] = ()
) -> list[Candidate]:
  """Models with one mechanism each, fitted from parameters that recalibration has not bent; often none.

  Args:
    problem: residuals.
    base: the recalibrated twin.
    priors: declarations of the base parameters.
    considered: ids that may be used.
    likely: ids to try at more than one size beside delays and lags, for instance the best of the scan.
  """
  delays = [m.name for m in by_subsystem(map(problem.mechanism, considered)) if m.sought_far]
  places = [_Place(priors.named(priors.nominal), _trials(problem, delays, _LARGE))]
  back, here, first = unbent(base, priors), base.free.named(base.values), dict.fromkeys([*delays, *likely])
  # a patch of floor anywhere, a change of grip at any time: too many starts to try all where nothing speaks for them
  others = [n for n in considered if n not in first and len(problem.mechanism(n).initial_guesses(problem.driving)) == 1]
  for along in (False, True):
    values = {name: value for name, value in back.items() if (name in _DRIVE) == along}
    if values:
      trials = _trials(problem, _about(problem, first, along), _USUAL)
      trials += _trials(problem, _about(problem, others, along), _WHOLE)
      places.append(_Place(here | values, trials))
  best: dict[str, tuple[float, dict[str, float]]] = {}
  for place in places:
    for cost, name, start in _worthwhile(problem, base, place, first):
      best[name] = min(best.get(name, (np.inf, {})), (cost, dict(place.values) | start), key=lambda t: t[0])
  chosen = sorted(best, key=lambda name: best[name][0])[:_MOST]
  made = [candidate(problem, (name,), None, priors, best[name][1]) for name in chosen]
  begin(problem, made)
  made += [model for name in considered for model in _exchanged(problem, base, priors, name)]
  refine(problem, made, 1, full=True)
  refine(problem, made, _STEPS - 1)
  return made


def _exchanged(problem: Problem, base: Candidate, priors: ParameterSet, name: str) -> list[Candidate]:
  """The model with a mechanism that does what those that imitate it have in common, at the best of a few sizes; []
  where the priors gain little by it."""
  trials = [candidate(problem, (name,), None, priors, start) for start in _shared(problem, base, name)]
  least = prior_cost(base.values, base.free) - _WORTH
  trials = [model for model in trials if prior_cost(model.values, model.free) < least]
  begin(problem, trials)
  return sorted(trials, key=lambda model: model.cost)[:1]


def _shared(problem: Problem, base: Candidate, name: str) -> list[dict[str, float]]:
  """Values where a mechanism does what those that imitate it have in common, in full or in whole control periods.

  Only those count whose channels were measured.
  """
  mechanism, here, period = problem.mechanism(name), base.free.named(base.values), problem.twin.period
  others = [m for m in map(problem.mechanism, mechanism.imitated_by) if measured(problem, m)]
  sizes = {p.name: here[p.name] for m in others for p in m.parameters if p.name in here}
  shared, own = min(sizes.values(), default=0.0), mechanism.parameters[0].name
  tried = {shared, period * math.floor(shared / period), period * math.ceil(shared / period)}
  left = lambda one: {other: size - one for other, size in sizes.items()}
  return [here | left(one) | {own: one} for one in sorted(tried) if one > 0.0]


def unbent(base: Candidate, priors: ParameterSet) -> dict[str, float]:
  """Nominal values of the measured parameters that recalibration moved further than is believable, by name."""
  here = base.free.named(base.values)
  away = priors.deviations([here[name] for name in priors.names])
  return {p.name: p.nominal for p, z in zip(priors, away, strict=True) if p.kind != "open" and abs(z) > _BENT}


def _about(problem: Problem, names: Iterable[str], along: bool) -> list[str]:
  """Those of some mechanisms that push the car along, or those that do not."""
  found = {name: problem.mechanism(name) for name in names}
  return [n for n, m in found.items() if (m.subsystem == "drive" or m.absorbed_by_drive) == along]


def _trials(problem: Problem, names: Iterable[str], sizes: tuple[float, ...]) -> list[tuple[str, dict[str, float]]]:
  found = []
  for name in names:
    mechanism = problem.mechanism(name)
    tried = sizes if mechanism.sought_far or not mechanism.signed else (-1.0, 1.0)
    found += [(name, start) for start in trial_starts(mechanism, tried, problem.driving)]
  return found


def _worthwhile(
  problem: Problem, base: Candidate, place: _Place, first: Collection[str]
) -> list[tuple[float, str, dict[str, float]]]:
  """Half the sum of squares, mechanism and values of the trials that are worth fitting.

  Of an unbent twin much makes up for something. What nothing speaks for but that must begin below the bent one. Most
  lie far above, as a part of the recordings tells.
  """
  if not place.trials:
    return []
  begin = varied(problem, base.theta, [place.values])[0]
  thetas = varied(problem, begin, [{}, *(start for _, start in place.trials)])
  highest, below = _RIVALS * base.cost, half_square(base.residual[: base.n_train]) - _WORTH
  limits = [highest if name in first else min(highest, below) for name, _ in place.trials]
  alone, *costs = problem.fitted_cost(thetas, np.array([np.inf, *limits]))
  return [
    (float(c), name, start)
    for c, limit, (name, start) in zip(costs, limits, place.trials, strict=True)
    if c < min(limit, alone - _WORTH)
  ]
