"""What makes no difference goes.

Lags, delays, ages and scales of sensors are fitted from the beginning, since their absence would bend the maps, and a
form that did in a curve's place may do nothing once others stand beside it. Whether the car has them is asked at the
end, of refits without. Each is left out alone, then the ones that nobody missed go together, the least missed first, as
far as driving that the twin was not fitted to bears it.
"""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from scipy.stats import norm

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.curves.flexible import DELAYS
from calibration.diagnosis.curves.naming.forms import LEVEL
from calibration.diagnosis.curves.naming.refits import Test, Trials, fit_together, tested
from calibration.diagnosis.curves.naming.sessions import contrasts
from calibration.diagnosis.score import clustered_std
from calibration.progress import Progress, silent


def without_the_needless(
  trials: Trials, progress: Progress = silent, known: Mapping[str, Test] | None = None
) -> tuple[Trials, Mapping[str, Test]]:
  """A twin without what it does as well without.

  What is too small to matter, yet more than chance, stays in the twin: it is no effect to tell of, and no harm.

  Args:
    trials: the twin.
    progress: reports the stage.
    known: what the twin is worth against one without each, where that was asked already.

  Returns:
    the twin; by mechanism beside the curves or in a curve's place, what the twin is worth against one without it: alone
    or, for the first of those nobody missed that can't go with the others, together with them.
  """
  asked = asked_of(trials)
  if not asked:
    return trials, {}
  progress("what the twin does as well without")
  problem, base = trials.problem, trials.base
  tests = dict(known or worth(trials, asked))
  goes = [name for name in asked if tests[name].chance * len(asked) >= LEVEL and not _holds_a_lead(trials, name)]
  goes.sort(key=lambda name: tests[name].t)
  models = [trials.model(without=parameters_of(trials, goes[: count + 1])) for count in range(len(goes))]
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


def asked_of(trials: Trials) -> list[str]:
  """What a twin can be asked to do without: all but what sessions differ in by more than chance.

  Without what those sessions share their shifts would stand in for it; shifts that are chance go with it.
  """
  different = _differ(trials)
  return [n for n in (*trials.beside, *trials.forms) if not _own(trials, [n]) & different]


def parameters_of(trials: Trials, names: Collection[str]) -> set[str]:
  """Of mechanisms, with the shifts that sessions have of them."""
  own = _own(trials, names)
  return own | {name for name in trials.base.free.names if "@" in name and name.split("@")[0] in own}


def stands_out(value: float, std: float, count: int) -> bool:
  """Whether one of `count` numbers differs from zero by more than chance, at an error rate over all of them."""
  return bool(abs(value) > float(norm.isf(0.5 * LEVEL / max(count, 1))) * std > 0.0)


def worth(trials: Trials, names: Sequence[str]) -> dict[str, Test]:
  """What a twin is worth against one without each of some mechanisms alone."""
  return {name: tested(m, trials.base, trials.problem) for name, m in without_each(trials, names).items()}


def without_each(trials: Trials, names: Sequence[str]) -> dict[str, Candidate]:
  """A twin fitted without each of some mechanisms alone."""
  models = {name: trials.model(without=parameters_of(trials, [name])) for name in names}
  fit_together(trials.problem, list(models.values()))
  return models


def matters(tests: Mapping[str, Test], name: str) -> bool:
  """Whether the twin misses a mechanism, at an error rate over all that are asked, by more than nobody would notice."""
  return tests[name].p_value * len(tests) < LEVEL


def _holds_a_lead(trials: Trials, name: str) -> bool:
  """A delay that takes back what commands were moved earlier by: it stays in the twin, be it a delay or not."""
  return name in DELAYS and trials.found.lead > 0.0


def _own(trials: Trials, names: Collection[str]) -> set[str]:
  return {p.name for name in names for p in trials.problem.mechanism(name).parameters}


def _differ(trials: Trials) -> set[str]:
  """Parameters of which some session's shift stands out from the mean of all."""
  base = trials.base
  asked = {name: weights for name, weights in contrasts(base.free.names).items() if "@" in name}
  if not asked:
    return set()
  directions = np.array(list(asked.values()))
  values, spread = directions @ base.values, clustered_std(base, trials.problem.observations, directions)
  out = [stands_out(value, std, len(asked)) for value, std in zip(values.tolist(), spread.tolist(), strict=True)]
  return {name.split("@")[0] for name, there in zip(asked, out, strict=True) if there}
