"""Names of maps, asked again once everything else has joined.

A map gets its name while what acts beside it may still be missing, and a richer form then makes up for it: a curve bent
at both ends where a lag is what bent it. When all have joined, every map that has a name is asked whether one of its
simpler forms would do by now, by the rule that named it: the one with the fewest parameters that is not refused.
"""

import dataclasses
from collections.abc import Sequence

from calibration.diagnosis.curves.naming.forms import LEVEL, Form, Outline
from calibration.diagnosis.curves.naming.refits import Trials, borne, fit_together, fitted_form, tested
from calibration.progress import Progress, silent


def made_simpler(
  trials: Trials, drawn: Sequence[Outline], progress: Progress = silent
) -> tuple[Trials, tuple[Outline, ...]]:
  """A twin whose maps have the simplest forms that will do beside all that has joined, and their outlines.

  A map that showed no departure at first may have been joined by forms of its own since: they are asked as well.
  """
  told = []
  for outline in drawn:
    family = tuple(n for n in trials.forms if trials.problem.mechanism(n).outlined_by == outline.curve)
    simpler = _simpler(trials, outline, family)
    if simpler:
      progress(f"simpler names for the {outline.curve.replace('_', ' ')}")
      trials, outline = _asked(trials, outline, family, simpler)
    told.append(outline)
  return trials, tuple(told)


def _simpler(trials: Trials, outline: Outline, family: Sequence[str]) -> list[Form]:
  """Forms of a map with fewer parameters than the ones it has in a twin."""
  used = sum(len(trials.problem.mechanism(name).parameters) for name in family)
  return [form for form in outline.forms if len(form.values) < used]


def _asked(trials: Trials, outline: Outline, family: Sequence[str], simpler: Sequence[Form]) -> tuple[Trials, Outline]:
  """With the simplest of the simpler forms that is not refused, if there is one."""
  problem, base = trials.problem, trials.base
  own = {p.name for name in family for p in problem.mechanism(name).parameters}
  now = {name: float(base.values[base.free.index(name)]) for name in own}
  models = [
    trials.model(form.mechanisms, {n: now.get(n, value) for n, value in form.values.items()}, own) for form in simpler
  ]
  of = {id(model): form for model, form in zip(models, simpler, strict=True)}
  tests = [(m, tested(m, base, problem)) for m in fit_together(problem, models)]
  will_do = [(m, test) for m, test in tests if borne(m, trials) >= LEVEL]
  if not will_do:
    return trials, outline
  chosen, test = min(will_do, key=lambda found: (len(of[id(found[0])].values), found[1].worse))
  form = fitted_form(of[id(chosen)].mechanisms, chosen, test, trials)
  smaller = trials.left_out(chosen, set(family) - set(form.mechanisms))
  if outline.named is None:
    return smaller, outline
  # the former name did no better, and is not told of as if it fitted as well
  others = [f for f in outline.forms if f.mechanisms not in (form.mechanisms, outline.named.mechanisms)]
  return smaller, dataclasses.replace(outline, forms=(form, *others))
