"""What is named against what is like it.

An effect stands in a twin because it was asked for first: it joined while something else was still missing, or it stood
beside the curves from the beginning. Whether one that is not in the twin would do better in its place is asked when all
have joined. A linear reckoning says which come into question: what is left without the effect, and how much of that
each of the others would explain beside everything that stays. Those are refitted in its place, and judged on driving
that neither was fitted to.
"""

import dataclasses
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.curves.naming.additions import open_questions
from calibration.diagnosis.curves.naming.forms import LEVEL, Outline
from calibration.diagnosis.curves.naming.refits import Test, Trials, borne, fit_together, sizes_of, tested
from calibration.diagnosis.curves.naming.removals import asked_of, matters, parameters_of, without_each
from calibration.diagnosis.scan import Projector, explained, resized, trial_starts, varied, worth_starting
from calibration.fitting.likelihood import Problem
from calibration.progress import Progress, silent
from qcar_twin.twin.mechanisms.base import Mechanism

_LIKE = 0.5  # of what an effect is worth that a rival explains in its place
_TRIED = 8  # rivals of a round that are refitted, those that explain most
_ROUNDS = 4
_SIZE = 0.8  # of the typical one
_BATCH = 24  # variants that are simulated side by side

Change = tuple[Mechanism, dict[str, float], NDArray[np.float64]]  # an effect, its parameters, what it does to residuals


@dataclasses.dataclass(frozen=True)
class Rival:
  """An effect that may stand in another's place.

  Attributes:
    mechanism: id; instead_of: id of the one that is in the twin.
    start: first values of its parameters.
    share: of what the other is worth that it explains in its place and not beside it, by a linear reckoning.
  """

  mechanism: str
  instead_of: str
  start: Mapping[str, float]
  share: float


def with_rivals(
  trials: Trials, progress: Progress = silent
) -> tuple[Trials, tuple[tuple[str, str], ...], Mapping[str, Test]]:
  """A twin whose effects none that is like them would do better in place of.

  Returns:
    the twin; (the one that went, the one that came) in order; what the twin is worth against one without each effect.
  """
  exchanged: list[tuple[str, str]] = []
  while True:
    progress(f"what else the named effects may be, {len(exchanged)} exchanged")
    models = without_each(trials, asked_of(trials))
    tests = {name: tested(model, trials.base, trials.problem) for name, model in models.items()}
    missed = {n: model for n, model in models.items() if matters(tests, n)}
    asked = {name for pair in exchanged for name in pair}
    step = _next(trials, rivals(trials, missed, asked)) if len(exchanged) < _ROUNDS else None
    if step is None:
      return trials, tuple(exchanged), tests
    trials, pair = step
    exchanged.append(pair)


def renamed(outline: Outline, exchanged: Sequence[tuple[str, str]], trials: Trials) -> Outline:
  """An outline with what took the place of its form, where that is a form of the same curve, as it is in a twin."""
  form = outline.named
  names = () if form is None else form.mechanisms
  for went, came in exchanged:
    if trials.problem.mechanism(came).outlined_by == outline.curve:
      names = tuple(came if name == went else name for name in names)
  if form is None or names == form.mechanisms or not set(names) <= set(trials.forms):
    return outline
  values, std = sizes_of(names, trials.base, trials.problem)
  said = dataclasses.replace(form, mechanisms=names, values=values, std=std)
  others = [f for f in outline.forms if f is not form and f.mechanisms != names]
  return dataclasses.replace(outline, forms=(said, *others))


def _next(trials: Trials, found: Sequence[Rival]) -> tuple[Trials, tuple[str, str]] | None:
  """The twin with the effect exchanged that gains most by it; None where each is as good as its rivals."""
  candidates = sorted(found, key=lambda r: -r.share)[:_TRIED]
  if not candidates:
    return None
  models = [trials.model((r.mechanism,), r.start, parameters_of(trials, [r.instead_of])) for r in candidates]
  of = {id(model): rival for model, rival in zip(models, candidates, strict=True)}
  fit_together(trials.problem, list(models))
  better = [m for m in models if _is_better(m, trials, len(models))]
  if not better:
    return None
  best = max(better, key=lambda m: tested(trials.base, m, trials.problem).nats)
  rival = of[id(best)]
  return trials.left_out(best, [rival.instead_of]), (rival.instead_of, rival.mechanism)


def _is_better(model: Candidate, trials: Trials, asked: int) -> bool:
  """Simpler and not refused; as simple and nearer; or less simple, and the other is refused."""
  base, problem = trials.base, trials.problem
  more = len(model.free) - len(base.free)
  if more < 0:
    return borne(model, trials) >= LEVEL
  found = tested(base, model, problem)
  return found.p_value * asked < LEVEL if more > 0 else found.nats > 0.0


def rivals(trials: Trials, missed: Mapping[str, Candidate], asked: Collection[str]) -> list[Rival]:
  """What explains much of what is left without an effect and little with it.

  Args:
    trials: the twin.
    missed: by effect that matters to it, the twin fitted without.
    asked: effects that are not asked again.
  """
  outside = [m for m in open_questions(trials) if m.name not in asked]
  models = {n: m for n, m in missed.items() if n not in asked and m.cost > trials.base.cost}
  if not models or not outside:
    return []
  changes = _changes(trials.problem, trials.base, outside)
  anyway = _explained(trials.base, changes)
  made = []
  for name, without in models.items():
    worth, acts_on = without.cost - trials.base.cost, trials.problem.mechanism(name).subsystem
    # what acts on the same signal changes it by another amount where the effect in question has not been there before
    anew = _changes(trials.problem, without, [m for m in outside if m.subsystem == acts_on])
    rest = [change for change in changes if change[0].subsystem != acts_on]
    for mechanism, (gain, start) in _explained(without, [*anew, *rest]).items():
      share = (gain - anyway[mechanism][0]) / worth
      if share >= _LIKE:
        made.append(Rival(mechanism, name, start, share))
  return made


def _explained(model: Candidate, changes: Sequence[Change]) -> dict[str, tuple[float, dict[str, float]]]:
  """What each effect explains beside a model, nats, and the values it does so with, by a linear reckoning."""
  project = Projector(model)
  left = project(model.residual[None, : model.n_train])[0]
  best: dict[str, tuple[float, dict[str, float]]] = {}
  for mechanism, start, whole in changes:
    change = project(whole[None])[0]
    gain = explained(change, left, mechanism.signed)
    if gain > best.get(mechanism.name, (-1.0, {}))[0]:
      size = worth_starting(-float(left @ change) / max(float(change @ change), 1e-12))
      best[mechanism.name] = gain, resized(mechanism, start, size)
  return best


def _changes(problem: Problem, model: Candidate, mechanisms: Sequence[Mechanism]) -> list[Change]:
  """What effects change of the residuals of a model, (K,) each."""
  jobs = [(m, start) for m in mechanisms for start in trial_starts(m, (_SIZE,), problem.driving)]
  thetas, made = varied(problem, model.theta, [start for _, start in jobs]), []
  for i in range(0, len(jobs), _BATCH):
    changed = problem.fitted_residual(thetas[i : i + _BATCH]) - model.residual[: model.n_train]
    made += [(*job, change) for job, change in zip(jobs[i : i + _BATCH], changed, strict=True)]
  return made
