"""Honest recalibration: the best the twin can do with the physics it has.

Everything that follows is measured against this fit, never against an uncalibrated twin. Weights
come from the noise model at first and from the fit's own residuals afterwards, so that a channel
full of road noise does not drown the others.
"""

import dataclasses
import logging
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.first_guess import best_start, held_close, varied_starts, where_limits_act
from calibration.fitting.likelihood import NOTICED, Problem, Weighting, flat_weighting, misled, trusted, weighting_from
from calibration.fitting.noise import ChannelNoise, noise_models
from calibration.fitting.noise_floor import sensor_floor
from calibration.fitting.observations import Observations, fitted_count, observe
from calibration.fitting.optimiser import FORWARD, STENCILS, Fit, fit, prior_cost
from calibration.fitting.slopes import Slopes, Stencil, central_differences
from calibration.fitting.surrogate import anchored
from calibration.fitting.tolerances import exchanged, weighed_beyond, widened
from calibration.fitting.windows import DEFAULT_CUT, Cut
from calibration.progress import Progress, silent
from qcar_twin.parameters import ParameterSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

_SPAN = 3  # iterations of a rough fit before the worse half of the starts is given up
_ROUNDS, _SETTLED = 8, 1.0  # corrections by MuJoCo, and nats that end them
_LONGEST = 40  # iterations between two corrections: a search ends where its slopes do, not by count
_AFAR = 4  # rounds of a fit from afar
_PART, _LEAST = 0.35, 85.0  # share of the driving a rough fit sees, and at least so many seconds


@dataclasses.dataclass(frozen=True)
class RecalibratedTwin:
  """The recalibrated twin without any mechanism.

  Attributes:
    problem: residuals with the final weights.
    noise_models: of the sensors, by channel.
    fit: the base parameters' fit.
    theta: full parameter vector with every mechanism at its null, (P,).
    jacobian: d whitened residual / d base parameters over all values, fitted and judging, (M, p).
    command_shift: command timing that fitted best, control periods.
  """

  problem: Problem
  noise_models: Mapping[str, ChannelNoise]
  fit: Fit
  theta: Array
  jacobian: Array
  command_shift: int


@dataclasses.dataclass(frozen=True)
class Begun:
  """Where a recalibration begins.

  Attributes:
    problem: residuals, weighted by what the rough fit leaves.
    base: what is fitted, p parameters.
    noise_models: of the sensors, by channel.
    start: estimates of a rough fit, (p,).
    command_shift: command timing that fitted best, control periods.
  """

  problem: Problem
  base: ParameterSet
  noise_models: Mapping[str, ChannelNoise]
  start: Array
  command_shift: int


def recalibrate(at: Begun, progress: Progress = silent) -> RecalibratedTwin:
  """The base parameters' fit from where it begins, within wider bounds where it stops at some.

  A first descent shows most of them, before MuJoCo is asked; the fit is made once more where it shows another, and with
  other weights where it stops at a tolerance.
  """
  known = _unknown(at.problem)
  near = _fit(at.problem, at.base, at.start, _LONGEST, 0.0, FORWARD, known).theta
  if (acting := where_limits_act(at.problem, at.base, near, _SETTLED)) is not None:
    near = _fit(at.problem, at.base, acting, _LONGEST, 0.0, FORWARD, known).theta
  wider = widened(at.base, near)
  least = _likelier(_least(at.problem, wider, near, known), progress)
  late = {p.name: p for p, q in zip(widened(at.base, least.fit.theta), at.base, strict=True) if p != q}
  if any(p != wider[name] for name, p in late.items()):
    progress("recalibration within wider bounds")
    wider = wider.replace(**late)
    least = _least(least.problem, wider, least.fit.theta, least.known)
  beyond, worth = weighed_beyond(least.problem, least.fit, least.slopes, sensor_floor(at.noise_models))
  if worth >= NOTICED:
    progress("recalibration, weighed by what goes on beyond a tolerance")
    least = least.weighed(beyond)
    least = _least(least.problem, wider, least.fit.theta, least.known)
  return _recalibrated(least, at.noise_models, at.command_shift)


@dataclasses.dataclass(frozen=True)
class _Least:
  """A minimum: the problem there, the fit, and slopes that are known of the problem."""

  problem: Problem
  fit: Fit
  known: Slopes

  @property
  def slopes(self) -> Array:
    """Of the fitted values, (n_train, p), by central differences: a scan and every larger model rest on them, and
    forward ones have the chatter of the point where the fit stands in every column."""
    base, problem = self.fit.parameters, self.problem
    residual = lambda v: problem.fitted_residual(problem.embed(base.names, v, problem.parameters.nominal))
    return self.known.at(residual, base, self.fit.theta, self.fit.residual, "deviation")

  def weighed(self, weighting: Weighting) -> "_Least":
    """The same place with other weights; what was known of its slopes is known still."""
    channel, rows = self.problem.observations.channel, slice(self.problem.n_train)
    factor = (weighting.scale(channel) / self.problem.weighting.scale(channel))[rows]
    return _Least(self.problem.reweighted(weighting), self.fit, self.known.weighed(factor))


def _least(problem: Problem, base: ParameterSet, start: Array, known: Slopes) -> _Least:
  """The minimum near a start: every model of a search is measured against it, so it is sought to a nat."""
  return _Least(*descended(problem, base, start, known=known), known)


def _likelier(least: _Least, progress: Progress) -> _Least:
  """The minimum, or one from where commands are late in place of all sensors, or the other way round, that is less."""
  start = exchanged(least.fit.parameters, least.fit.theta, _SETTLED)
  if start is None:
    return least
  progress("recalibration with commands late in place of sensors")
  other = _least_from(least.problem, least.fit.parameters, start)
  return other if other.fit.cost < least.fit.cost - _SETTLED else least


def begun(
  twin: Twin,
  recordings: Sequence[Recording],
  priors: ParameterSet | None = None,
  shifts: Sequence[int] = (0,),
  cut: Cut = DEFAULT_CUT,
  progress: Progress = silent,
) -> Begun:
  """A rough fit to a part of recordings, and the problem of all that is cut of them.

  Args:
    twin: the car with the whole catalogue, all at null.
    recordings: those of role "validate" are not fitted; they only judge.
    priors: base parameters with better first guesses than the vehicle's nominal ones.
    shifts: command timings to try, control periods; more than one where the log's convention is unknown.
    cut: how recordings are cut.
    progress: reports what is being done.
  """
  recordings = sorted(recordings, key=lambda r: r.role == "validate")
  noise = noise_models(recordings)
  base, floor = priors or twin.base, sensor_floor(noise)
  driven = sum(r.duration for r in recordings)
  # weights are read off its residuals, so the part must be like the whole
  part = dataclasses.replace(cut, evenly=True, most=max(_LEAST, _PART * min(driven, cut.most)))
  attempts = []
  for shift in shifts:
    progress(f"recalibration, commands shifted by {shift}" if len(shifts) > 1 else "recalibration")
    attempts.append(_approach(twin, recordings, base, floor, dataclasses.replace(part, command_shift=shift)))
  raw = np.array([np.sum(np.abs(attempts[0][0].whiten(a[1]))[: attempts[0][0].n_train]) for a in attempts])
  start, shift = attempts[int(np.argmin(raw))][2], shifts[int(np.argmin(raw))]
  observations = observe(recordings, twin.vehicle, dataclasses.replace(cut, command_shift=shift))
  twin = anchored(twin, base.names, start)
  problem = _weighted(twin, observations, fitted_count(observations, recordings), base, start, floor)
  return Begun(problem, base, noise, start, shift)


def begun_nearer(at: Begun) -> Begun:
  """The same from where forward differences see no more gain, with weights from the residuals there."""
  start = _fit(at.problem, at.base, at.start, _LONGEST, 0.0).theta
  old, floor = at.problem, sensor_floor(at.noise_models)
  problem = _weighted(old.twin, old.observations, old.n_train, at.base, start, floor)
  return dataclasses.replace(at, problem=problem, start=start)


def recalibrate_from(baseline: RecalibratedTwin, theta: Array) -> RecalibratedTwin:
  """The recalibrated twin fitted again from estimates of all parameters, (P,), weighted by the residuals there."""
  old, base = baseline.problem, baseline.fit.parameters
  start = theta[[old.parameters.index(name) for name in base.names]]
  problem = _weighted(
    old.at(theta).twin, old.observations, old.n_train, base, start, sensor_floor(baseline.noise_models)
  )
  return settled(problem, baseline.noise_models, base, start, baseline.command_shift)


def reweighted(recalibrated: RecalibratedTwin) -> Problem:
  """The problem with weights from the residuals of the fit: those of a rough one let channels slip that it missed."""
  old, floor = recalibrated.problem.at(recalibrated.theta), sensor_floor(recalibrated.noise_models)
  return _weighted(old.twin, old.observations, old.n_train, recalibrated.fit.parameters, recalibrated.fit.theta, floor)


def settled(
  problem: Problem,
  noise_models: Mapping[str, ChannelNoise],
  base: ParameterSet,
  start: Array,
  command_shift: int,
) -> RecalibratedTwin:
  """The recalibrated twin at the minimum near a start."""
  return _recalibrated(_least(problem, base, start, _unknown(problem)), noise_models, command_shift)


def settled_from(recalibrated: RecalibratedTwin, start: Array) -> RecalibratedTwin:
  """The same fit from another start, (p,)."""
  least = _least_from(recalibrated.problem, recalibrated.fit.parameters, start)
  return _recalibrated(least, recalibrated.noise_models, recalibrated.command_shift)


def _least_from(problem: Problem, base: ParameterSet, start: Array) -> _Least:
  """The minimum from another start, (p,), in rounds while they gain: from afar one may not come to its end."""
  least = _least(problem, base, start, _unknown(problem))
  iterations = least.fit.iterations
  for _ in range(_AFAR):
    before = least.fit.cost
    least = _least(problem, base, least.fit.theta, least.known)
    if before - least.fit.cost < _SETTLED:
      break
  return dataclasses.replace(least, fit=dataclasses.replace(least.fit, iterations=iterations))


def _recalibrated(least: _Least, noise_models: Mapping[str, ChannelNoise], command_shift: int) -> RecalibratedTwin:
  """The twin at a minimum, with slopes of all values, fitted and judging."""
  problem, slopes, base = least.problem, least.slopes, least.fit.parameters
  full = lambda v: problem.embed(base.names, v, problem.parameters.nominal)
  residual, theta = lambda v: problem.judging_residual(full(v)), least.fit.theta
  smooth = residual(theta[None])[0], problem.observations.stretch[problem.n_train :]
  judging = central_differences(residual, base, theta, least.known.widths, smooth)
  jacobian = np.concatenate([slopes, judging])
  return RecalibratedTwin(problem, noise_models, least.fit, full(theta)[0], jacobian, command_shift)


def _unknown(problem: Problem) -> Slopes:
  """Slopes of a problem, none of which is known yet."""
  return Slopes(problem.observations.stretch[: problem.n_train])


def descended(
  problem: Problem, base: ParameterSet, start: Array, enough: float = _SETTLED, known: Slopes | None = None,
  guard: bool = True,
) -> tuple[Problem, Fit]:  # fmt: skip
  """The minimum, and the problem there.

  Args:
    problem: put right at the start, or not yet.
    base: what is fitted.
    start: first estimates, (p,).
    enough: nats; a correction by MuJoCo that promises less is the last one.
    known: slopes of the same problem from an earlier search.
    guard: where MuJoCo does not confirm a step, the stretches in which the slopes of the two differ are left to it from
      then on, which takes many times as long; else the search ends there.

  A surrogate is put right by MuJoCo wherever its own minimum lay, until it predicts no reduction: by forward
  differences first, and where these see none by the wide stencils of a rough cost, too.
  """
  embedded = lambda values: problem.embed(base.names, values, problem.parameters.nominal)[0]
  known = known or _unknown(problem)
  if problem.exact is problem:
    return problem, _fit(problem, base, start, _LONGEST, 0.0, (*FORWARD, *STENCILS), known)
  stencils = FORWARD
  minimum = _fit(problem, base, start, _LONGEST, 0.0, stencils, known)
  theta, cost = start, _cost(problem, base, start)
  for _ in range(_ROUNDS):
    predicted = cost - minimum.cost
    if predicted < enough and stencils == FORWARD:
      stencils = STENCILS
      minimum = _fit(problem, base, theta, _LONGEST, 0.0, stencils, known)
      predicted = cost - minimum.cost
    if predicted < enough:
      break
    there = problem.at(embedded(minimum.theta))
    actual = cost - _cost(there, base, minimum.theta)
    log.info("MuJoCo: %.1f nats of the %.1f that the surrogate predicted", actual, predicted)
    led = trusted(predicted, actual)
    if not led and guard:
      guarded = misled(problem, embedded(theta), embedded(minimum.theta))
      log.info("left to MuJoCo: %s", guarded)
      problem, there = problem.guarding(guarded), there.guarding(guarded)
      known.forget()
    if actual > 0.0:
      problem, theta, cost = there, minimum.theta, cost - actual
    if (led and actual <= 0.0) or not (led or guard):
      break
    minimum = _fit(problem, base, theta, _LONGEST, 0.0, stencils, known)
  residual = problem.fitted_residual(embedded(theta)[None])[0]
  return problem, dataclasses.replace(minimum, theta=theta, residual=residual, cost=cost)


def _cost(problem: Problem, base: ParameterSet, theta: Array) -> float:
  """Of estimates of the base parameters, nats."""
  residual = problem.fitted_residual(problem.embed(base.names, theta, problem.parameters.nominal))[0]
  return 0.5 * float(residual @ residual) + prior_cost(theta, base)


def _approach(
  twin: Twin, recordings: Sequence[Recording], base: ParameterSet, floor: Mapping[str, float], cut: Cut
) -> tuple[Problem, Array, Array]:
  """A rough fit on part of the driving: the problem, predicted minus measured, and the estimates."""
  observations = observe(recordings, twin.vehicle, cut)
  n_train = fitted_count(observations, recordings)
  start, held = best_start(twin, observations, n_train, base), held_close(base)
  problem = _weighted(twin, observations, n_train, base, start, floor)
  rough = _halved(problem, held, varied_starts(base, start))
  problem = _weighted(twin, observations, n_train, base, rough, floor)
  rough = _fit(problem, base, rough, 4, 5e-3).theta
  return problem, problem.raw(problem.embed(base.names, rough, twin.parameters.nominal))[0], rough


def _halved(problem: Problem, base: ParameterSet, starts: Sequence[Array]) -> Array:
  """The best of several starts, by successive halving: a few iterations each, then the better half goes on.

  Source: Jamieson and Talwalkar, Non-stochastic best arm identification and hyperparameter optimization, AISTATS 2016.
  """
  fits = [_fit(problem, base, start, _SPAN, 1e-2) for start in starts]
  while len(fits) > 1:
    better = sorted(fits, key=lambda f: f.cost)[: len(fits) // 2]
    fits = [_fit(problem, base, f.theta, _SPAN, 1e-2) for f in better]
  return fits[0].theta


def _fit(
  problem: Problem, base: ParameterSet, start: Array, iterations: int, tolerance: float,
  stencils: Sequence[Stencil] = FORWARD, known: Slopes | None = None,
) -> Fit:  # fmt: skip
  around = problem.parameters.nominal
  residual = lambda v: problem.fitted_residual(problem.embed(base.names, v, around))
  report = lambda i, cost: log.info("iteration %d: cost %.1f", i, cost)
  return fit(residual, base, start, iterations, np.inf, tolerance, progress=report, stencils=stencils, slopes=known)


def _weighted(
  twin: Twin, observations: Observations, n_train: int, base: ParameterSet, theta: Array, floor: Mapping[str, float]
) -> Problem:
  """The problem with weights from the residuals at theta."""
  problem = Problem(twin, observations, flat_weighting(observations), n_train, base.names)
  raw = problem.raw(problem.embed(base.names, theta, twin.parameters.nominal))[0]
  return problem.reweighted(weighting_from(observations, raw, floor))
