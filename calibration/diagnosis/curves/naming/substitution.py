"""Named forms in a curve's place, told by refits on the driving itself.

A curve's heights and their covariance say which forms come into question (forms.py). Whether one will do is asked of
the recordings: the twin is refitted with the form instead of the curve, and with neither, and the simplest twin stays
that predicts driving it was not fitted to as well as the curve does. Where none does, the curve has no known form.
"""

import dataclasses
from collections.abc import Sequence

from calibration.diagnosis.curves.naming.forms import Form, Outline
from calibration.diagnosis.curves.naming.refits import Trials, fit_together, fitted_form, tested
from calibration.progress import Progress, silent

_PAIRS = 4  # of two forms each that are refitted: the best of all by the heights alone


def substituted(
  trials: Trials, drawn: Sequence[Outline], progress: Progress = silent
) -> tuple[Trials, tuple[Outline, ...]]:
  """Ask every curve of a twin for its name, one after the other, each beside what the others were given.

  Returns:
    the twin with named forms where they will do and curves where none will; the curves as they were fitted, their forms
    with estimates and p-values of the refits.
  """
  told, left = [], {o.curve: o for o in drawn}
  for name in sorted(left, key=_turn):
    progress(f"names for the {name.replace('_', ' ')}")
    trials, outline = _named(trials, left[name])
    told.append(outline)
  return trials, tuple(told)


def named_again(
  trials: Trials, drawn: Sequence[Outline], progress: Progress = silent
) -> tuple[Trials, tuple[Outline, ...]]:
  """Ask the curves that are left for their names once more, beside all that has joined since."""
  told = []
  for outline in drawn:
    if outline.curve in trials.curves:
      progress(f"names for the {outline.curve.replace('_', ' ')}, once more")
      trials, outline = _named(trials, outline)
    told.append(outline)
  return trials, tuple(told)


def named_only(trials: Trials, told: Sequence[Outline]) -> Trials:
  """The twin with the best of the forms in place of the curves, too, that none will do for."""
  for outline in told:
    if outline.curve in trials.curves:
      trials, _ = _named(trials, outline, whatever=True)
  return trials


def _turn(curve: str) -> tuple[bool, bool]:
  """Steering before the drive, and losses last: they make up for either."""
  return not curve.startswith("steering"), not curve.startswith("drive")


def _named(trials: Trials, outline: Outline, whatever: bool = False) -> tuple[Trials, Outline]:
  """With the form that will do in the curve's place; `whatever`: with the best, will it do or not."""
  problem, curve = trials.problem, trials.problem.mechanism(outline.curve)
  heights = {p.name for p in curve.parameters}
  tried = [trials.model(forms, start, heights) for forms, start in _options(outline)]
  names = {id(m): forms for m, (forms, _) in zip(tried, _options(outline), strict=True)}
  tests = {names[id(m)]: (m, tested(m, trials.base, problem)) for m in fit_together(problem, tried, tried[0])}
  told = tuple(sorted((fitted_form(n, *found, trials) for n, found in tests.items() if n), key=_plainness))
  nothing = tests[()][1]
  outline = dataclasses.replace(outline, departs=nothing.p_value, forms=told, without=nothing.worse)
  if not outline.is_there:
    chosen = ()
  elif outline.named:
    chosen = outline.named.mechanisms
  elif whatever:
    chosen = min(tests, key=lambda names: tests[names][1].worse)
  else:
    return trials, outline
  return trials.going_on_from(tests[chosen][0], outline.curve), outline


def _options(outline: Outline) -> list[tuple[tuple[str, ...], dict[str, float]]]:
  """Neither curve nor form, every form, and the best pairs by the heights, with first values."""
  single = [f for f in outline.forms if len(f.mechanisms) == 1]
  pairs = sorted((f for f in outline.forms if len(f.mechanisms) > 1), key=lambda f: f.misfit)[:_PAIRS]
  return [((), {}), *((f.mechanisms, dict(f.values)) for f in (*single, *pairs))]


def _plainness(form: Form) -> tuple[int, float]:
  return len(form.values), form.misfit
