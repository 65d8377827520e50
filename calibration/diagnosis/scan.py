"""The scan: every mechanism at finite size, with what recalibration can absorb projected out.

A mechanism's signature at a size is the change of all residuals it makes. What the base parameters
could imitate is removed (within their priors), so the rest is what only this mechanism can explain.
The scan nominates; the refit decides. By-products: how much of each effect these manoeuvres would
show at all (concealment), and which effects look alike on them (confusion).
"""

import dataclasses
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.fitting.likelihood import Problem
from calibration.fitting.optimiser import inverse_curvature
from calibration.progress import Progress, silent
from qcar_twin.parameters import ParameterSet
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import AS_GOOD, Mechanism

Array = NDArray[np.float64]

SIZES = (0.8,)
_OCTAVES = (0.5, 1.0, 2.0, 4.0)  # times these, of what does nothing below a threshold
_INVISIBLE = 3.0  # nats at typical size below which a mechanism can't be tested
# needed channels that are compared under another name
_SHOWN_BY = {"pose_x": {"pose_forward", "path_forward"}, "speed": set(AS_GOOD["speed"])}


@dataclasses.dataclass(frozen=True)
class Signature:
  """One mechanism on these recordings.

  Attributes:
    mechanism: id.
    start: parameter values of the best trial.
    answer: by how much the base parameters would move to meet it, by name.
    gain: half the drop of the projected sum of squares at the best trial, and what priors are met better, nats.
    shown: half the squared norm of the projected signature at typical size, nats: what the
      manoeuvres would show of it where its shape shows most (a change of grip after the last run shows nothing); 0
      where a channel was not measured without which it cannot be told apart.
    unabsorbed_share: share of that signature that recalibration cannot absorb, 0 to 1.
    direction: projected signature of the best trial on the fitted values, (K,), float32.
    unprofiled: gain of the best trial if nothing is projected out, nats: what a plain ranking would go by.
    tried, imitated: values of the best trial as it was scanned, whose `direction` it is, and how the base parameters
      would move to imitate it, by name.
  """

  mechanism: str
  start: dict[str, float]
  answer: dict[str, float]
  gain: float
  shown: float
  unabsorbed_share: float
  direction: NDArray[np.float32]
  unprofiled: float
  tried: dict[str, float] = dataclasses.field(default_factory=dict)
  imitated: dict[str, float] = dataclasses.field(default_factory=dict)

  @property
  def testable(self) -> bool:
    return self.shown >= _INVISIBLE


@dataclasses.dataclass(frozen=True)
class Trial:
  """One mechanism at one size.

  Attributes:
    start: parameter values.
    rest: change of residuals without what the base can imitate, (K,).
    strain: change of the base parameters' deviations from their priors as they imitate it, (p,).
    unabsorbed: share of the whole change's squared norm that is left in `rest`.
    shown: half the squared norm of `rest`, by the noise of each channel, nats.
    answer: how the base parameters would move to meet it, (p,).
    unprofiled: nats the whole change explains at its best size.
  """

  start: dict[str, float]
  rest: NDArray[np.float32]
  strain: Array
  unabsorbed: float
  shown: float
  answer: Array
  unprofiled: float


class Projector:
  """Removes from a change of residuals what the free parameters of a model can imitate.

  A parameter that stopped at its bound imitates nothing: it would have to go on beyond it.
  """

  def __init__(self, model: Candidate, held: Collection[str] = ()):
    """`held`: parameters that imitate nothing, either."""
    loose = ~at_bound(model) & ~np.isin(model.free.names, list(held))
    self._jacobian = model.jacobian[: model.n_train] * loose
    self._slopes = model.free.deviation_slopes(model.values)
    free = np.flatnonzero(loose)
    self._inverse = np.zeros((len(loose), len(loose)))
    kept = ParameterSet(model.free[model.free.names[i]] for i in free)
    self._inverse[np.ix_(free, free)] = inverse_curvature(model.curvature[np.ix_(free, free)], kept)

  def __call__(self, change: Array) -> Array:
    """Rows (n, K) over the fitted values, without their projection on the model's columns."""
    return change + self.answer(change) @ self._jacobian.T

  def answer(self, change: Array) -> Array:
    """How the free parameters move to make up for a change of residuals, (n, p)."""
    return -(change @ self._jacobian) @ self._inverse

  def strain(self, answer: Array) -> Array:
    """How the parameters' deviations from their priors change as they move so, (n, p): residuals, too."""
    return answer * self._slopes


def at_bound(model: Candidate) -> NDArray[np.bool_]:
  """Free parameters that stand at a bound, (p,)."""
  reach = 1e-6 * model.free.scale
  return (model.values <= model.free.lower + reach) | (model.values >= model.free.upper - reach)


def scan(
  problem: Problem,
  base: Candidate,
  mechanisms: Sequence[Mechanism],
  sizes: Sequence[float] = SIZES,
  progress: Progress = silent,
  noise: Mapping[str, float] | None = None,
) -> dict[str, Signature]:
  """Signatures of mechanisms against a fitted model.

  Args:
    problem: residuals.
    base: the recalibrated twin, with its Jacobian.
    mechanisms: the catalogue.
    sizes: multiples of the typical size to try. A signed mechanism is tried with one sign and scaled
      with both: its signature is odd in its size to first order, and the refit sees to the rest. At the contact
      both signs are tried: less grip makes wheels slide that more grip would not have changed. So are both of what has
      a side: a session in a mirror has the same evidence.
    progress: reports the share of the trials that is done.
    noise: of each residual channel while the car drives; where a channel's weight is that of the base's error instead,
      what is `shown` is counted as it would be without that error: an effect must not hide by the misfit it makes.
  """
  clear = problem.clear(noise) if noise else 1.0
  freed = {m.name: {p.name for p in m.parameters} & set(base.free.names) for m in mechanisms}  # don't imitate it
  projectors = {name: Projector(base, own) for name, own in freed.items() if own}
  common = Projector(base)
  stands = problem.parameters.named(base.theta)
  jobs = [(m, start) for m in mechanisms for start in trial_starts(m, _tried(m, sizes), problem.driving, stands)]
  residual, deviations = base.residual[: base.n_train], base.free.deviations(base.values)
  collected: dict[str, list[Trial]] = {m.name: [] for m in mechanisms}
  chunk = 24
  for i in range(0, len(jobs), chunk):
    part = jobs[i : i + chunk]
    change = problem.fitted_residual(varied(problem, base.theta, [start for _, start in part])) - residual
    for (mechanism, start), whole in zip(part, change, strict=True):
      project = projectors.get(mechanism.name, common)
      rest, answer = project(whole[None])[0], project.answer(whole[None])[0]
      plain = explained(whole, residual, mechanism.signed)
      seen = clear * rest
      share = float(rest @ rest) / float(whole @ whole) if np.any(whole) else 0.0
      shown = 0.5 * float(seen @ seen)
      trial = Trial(start, rest.astype(np.float32), project.strain(answer), share, shown, answer, plain)
      collected[mechanism.name].append(trial)
    progress("scan", min(i + chunk, len(jobs)) / len(jobs))
  left = (residual, deviations)
  found = {
    m.name: _signature(m, collected[m.name], left, base.free.names, stands) for m in mechanisms if collected[m.name]
  }
  blind = [m.name for m in mechanisms if m.name in found and not measured(problem, m)]
  return found | {name: dataclasses.replace(found[name], shown=0.0) for name in blind}


def measured(problem: Problem, mechanism: Mechanism) -> bool:
  """Whether all channels were measured that a mechanism declares to need."""
  present = set(problem.observations.present)
  return all(_SHOWN_BY.get(channel, {channel}) & present for channel in mechanism.needs)


def _tried(mechanism: Mechanism, sizes: Sequence[float]) -> Sequence[float]:
  """Sizes of the trials: both signs of what acts at the contact or has a side, octaves of what has a threshold."""
  both = mechanism.signed and (mechanism.stage == "contact" or not mechanism.symmetric)
  sizes = [octave * size for size in sizes for octave in (_OCTAVES if mechanism.from_threshold else (1.0,))]
  return (*sizes, *(-size for size in sizes)) if both else sizes


def trial_starts(
  mechanism: Mechanism, sizes: Sequence[float], driving: Driving, stands: Mapping[str, float] | None = None
) -> list[dict[str, float]]:
  """Parameter values to try on some driving: each amplitude alone, multiples of its typical size from its null, or from
  where a model `stands` that tolerates some of it, within its bounds.

  Where shape parameters need several starts, one size does, with either sign if given: the refit finds the rest.
  """
  starts = []
  places = mechanism.initial_guesses(driving)
  if len(places) > 1:
    middle = sorted(abs(size) for size in sizes)[len(sizes) // 2]
    sizes = [size for size in sizes if abs(size) == middle]
  for place in places:
    for parameter in mechanism.parameters:
      if parameter.null is None:
        continue
      typical = parameter.typical or parameter.scale
      for size in sizes:
        value = (stands or {}).get(parameter.name, parameter.null) + size * typical
        starts.append({**place, parameter.name: float(np.clip(value, parameter.lower, parameter.upper))})
  return starts


def explained(change: Array, residual: Array, signed: bool = False) -> float:
  """Drop of half the sum of squares when a change of residuals is added at its best size, nats; < 0 only if signed."""
  power = float(change @ change)
  pull = -float(residual @ change)
  pull = abs(pull) if signed else max(pull, 0.0)
  return 0.5 * pull**2 / power if power > 0 else 0.0


def confusion(signatures: dict[str, Signature]) -> dict[str, dict[str, float]]:
  """Cosine between the projected signatures of two mechanisms, for pairs that look alike (above 0.7)."""
  names = [n for n, s in signatures.items() if s.testable]
  if not names:
    return {}
  stack = np.stack([signatures[n].direction for n in names])
  norm = np.linalg.norm(stack, axis=1)
  norm[norm == 0.0] = 1.0  # what shows nowhere is like nothing
  cosine = np.abs(stack @ stack.T) / np.outer(norm, norm)
  return {
    a: {b: float(cosine[i, j]) for j, b in enumerate(names) if i != j and cosine[i, j] > 0.7}
    for i, a in enumerate(names)
  }


def varied(problem: Problem, theta: Array, starts: Sequence[Mapping[str, float]]) -> Array:
  """Full parameters, (n, P): those of theta, (P,), with some values changed in each row."""
  rows = np.tile(theta, (len(starts), 1))
  for row, start in zip(rows, starts, strict=True):
    row[[problem.parameters.index(name) for name in start]] = list(start.values())
  return rows


def _signature(
  mechanism: Mechanism,
  trials: list[Trial],
  left: tuple[Array, Array],
  base: Sequence[str],
  stands: Mapping[str, float],
) -> Signature:
  factors, gains = zip(*(_scaled(mechanism, trial, *left) for trial in trials), strict=True)
  top = int(np.argmax(gains))
  most = max(trials, key=lambda t: t.shown)
  return Signature(
    mechanism=mechanism.name,
    start=resized(mechanism, trials[top].start, factors[top], stands),
    answer=dict(zip(base, (factors[top] * trials[top].answer).tolist(), strict=True)),
    gain=gains[top],
    shown=most.shown,
    unabsorbed_share=most.unabsorbed,
    direction=trials[top].rest,
    unprofiled=max(t.unprofiled for t in trials),
    tried=trials[top].start,
    imitated=dict(zip(base, trials[top].answer.tolist(), strict=True)),
  )


def _scaled(mechanism: Mechanism, trial: Trial, residual: Array, deviations: Array) -> tuple[float, float]:
  """Factor on a trial's size that fits best, and its gain: sizes between trials need no trial of their own.

  What the recalibrated twin has imitated shows in its parameters' deviations from their priors.
  """
  power = float(trial.rest @ trial.rest) + float(trial.strain @ trial.strain)
  pull = float(residual @ trial.rest) + float(deviations @ trial.strain)
  lowest = -2.0 if mechanism.signed else 0.0
  best = float(np.clip(-pull / power, lowest, 2.0)) if power > 0 else 0.0
  return worth_starting(best), -best * pull - 0.5 * best**2 * power


def worth_starting(factor: float) -> float:
  """A factor on a trial's size, a tenth at least: a refit that starts at nothing has no slope to follow."""
  return factor if abs(factor) > 0.1 else 0.1


def resized(
  mechanism: Mechanism, start: Mapping[str, float], factor: float, stands: Mapping[str, float] | None = None
) -> dict[str, float]:
  """Values with the amplitudes so many times as far from their null, or from where a model `stands` that tolerates some
  of them, within their bounds."""
  values = dict(start)
  for p in mechanism.parameters:
    if p.null is not None and p.name in start:
      near = (stands or {}).get(p.name, p.null)
      values[p.name] = float(np.clip(near + factor * (start[p.name] - near), p.lower, p.upper))
  return values
