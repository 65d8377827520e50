"""Names of maps, asked again once everything else has joined.

A map gets its name while what acts beside it may still be missing, and a richer form then makes up for it: a curve bent
at both ends where a lag is what bent it. When all have joined, every map that has a name is asked whether one of its
simpler forms would do by now, by the rule that named it: the one with the fewest parameters that is not refused.
"""

import dataclasses
from collections.abc import Sequence

from calibration.characterise.naming.forms import LEVEL, Form, Outline
from calibration.characterise.naming.refits import Trials, fit_together, fitted_form, tested
from calibration.progress import Progress, silent


def made_simpler(
  trials: Trials, drawn: Sequence[Outline], progress: Progress = silent
) -> tuple[Trials, tuple[Outline, ...]]:
  """A twin whose maps have the simplest forms that will do beside all that has joined, and their outlines."""
  told = []
  for outline in drawn:
    simpler = _simpler(trials, outline)
    if simpler:
      progress(f"simpler names for the {outline.curve.replace('_', ' ')}")
      trials, outline = _asked(trials, outline, simpler)
    told.append(outline)
  return trials, tuple(told)


def _simpler(trials: Trials, outline: Outline) -> list[Form]:
  """Forms of a map that is in a twin by name, with fewer parameters than the name has."""
  form = outline.named
  if form is None or not set(form.mechanisms) <= set(trials.forms):
    return []
  used = set(trials.forms) - set(form.mechanisms)
  return [f for f in outline.forms if len(f.values) < len(form.values) and not used & set(f.mechanisms)]


def _asked(trials: Trials, outline: Outline, simpler: Sequence[Form]) -> tuple[Trials, Outline]:
  """With the simplest of the simpler forms that is not refused, if there is one."""
  problem, base, name = trials.problem, trials.base, outline.named
  assert name is not None
  now = {p: float(base.values[base.free.index(p)]) for p in name.values}
  models = [trials.model(f.mechanisms, {**f.values, **{p: now[p] for p in f.values if p in now}}, now) for f in simpler]
  of = {id(model): form for model, form in zip(models, simpler, strict=True)}
  tests = [(m, tested(m, base, problem)) for m in fit_together(problem, models)]
  will_do = [(m, test) for m, test in tests if test.p_value * len(models) >= LEVEL]
  if not will_do:
    return trials, outline
  chosen, test = min(will_do, key=lambda found: (len(of[id(found[0])].values), found[1].worse))
  form = fitted_form(of[id(chosen)].mechanisms, chosen, test, problem)
  # the former name did no better, and is not told of as if it fitted as well
  others = [f for f in outline.forms if f.mechanisms not in (form.mechanisms, name.mechanisms)]
  gone = set(name.mechanisms) - set(form.mechanisms)
  return trials.left_out(chosen, gone), dataclasses.replace(outline, forms=(form, *others))
