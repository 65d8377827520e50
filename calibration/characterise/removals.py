"""What makes no difference goes.

Lags, delays, ages and scales of sensors are fitted from the beginning, since their absence would bend the maps, and a
form that did in a curve's place may do nothing once others stand beside it. Whether the car has them is asked at the
end, of refits without. Each is left out alone, then the ones that nobody missed go together, the least missed first, as
far as driving that the twin was not fitted to bears it.
"""

from collections.abc import Mapping, Sequence

from calibration.characterise.flexible import DELAYS
from calibration.characterise.forms import LEVEL
from calibration.characterise.refits import Test, Trials, fit_together, tested
from calibration.progress import Progress, silent


def without_the_needless(trials: Trials, progress: Progress = silent) -> tuple[Trials, Mapping[str, Test]]:
  """A twin without what it does as well without.

  What is too small to matter, yet more than chance, stays in the twin: it is no effect to tell of, and no harm.

  Returns:
    the twin; by mechanism beside the curves or in a curve's place, what the twin is worth against one without it: alone
    or, for the first of those nobody missed that can't go with the others, together with them.
  """
  asked = [name for name in (*trials.beside, *trials.forms) if name not in _shared_with_sessions(trials)]
  if not asked:
    return trials, {}
  progress("what the twin does as well without")
  problem, base = trials.problem, trials.base
  tests = worth(trials, asked)
  goes = [name for name in asked if tests[name].chance * len(asked) >= LEVEL and not _holds_a_lead(trials, name)]
  goes.sort(key=lambda name: tests[name].t)
  models = [trials.model(without=_parameters(trials, goes[: count + 1])) for count in range(len(goes))]
  fit_together(problem, list(models))
  borne = None
  for last, model in enumerate(models):
    test = tested(model, base, problem)
    if test.chance * len(asked) < LEVEL:
      tests[goes[last]] = test
      goes = goes[:last]
      break
    borne = model
  return (trials.left_out(borne, goes) if borne else trials), tests


def worth(trials: Trials, names: Sequence[str]) -> dict[str, Test]:
  """What a twin is worth against one without each of some mechanisms alone."""
  models = {name: trials.model(without=_parameters(trials, [name])) for name in names}
  fit_together(trials.problem, list(models.values()))
  return {name: tested(model, trials.base, trials.problem) for name, model in models.items()}


def matters(tests: Mapping[str, Test], name: str) -> bool:
  """Whether the twin misses a mechanism, at an error rate over all that are asked, by more than nobody would notice."""
  return tests[name].p_value * len(tests) < LEVEL


def _holds_a_lead(trials: Trials, name: str) -> bool:
  """A delay that takes back what commands were moved earlier by: it stays in the twin, be it a delay or not."""
  return name in DELAYS and trials.found.lead > 0.0


def _parameters(trials: Trials, names: list[str]) -> set[str]:
  return {p.name for name in names for p in trials.problem.mechanism(name).parameters}


def _shared_with_sessions(trials: Trials) -> set[str]:
  """What sessions have shifts of: without what they share the shifts would stand in for it."""
  shifted = {name.split("@")[0] for name in trials.base.free.names if "@" in name}
  return {name for name in (*trials.beside, *trials.forms) if _parameters(trials, [name]) & shifted}
