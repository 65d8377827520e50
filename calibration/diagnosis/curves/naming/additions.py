"""Named effects beside the maps: one at a time, each refitted with everything else.

Curves outline what an actuator does at once. What has a memory, or acts at a place or on the tyres, is told apart only
where the maps are right already, so it is sought from there: every mechanism of the catalogue is scanned against the
twin, the most promising are refitted with all that is free, and the one that does most for driving it was not fitted to
joins, as long as that is more than chance over all that were tried and some channel gets better by what matters.
"""

import dataclasses

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.curves.naming.forms import LEVEL
from calibration.diagnosis.curves.naming.refits import Test, Trials, fit_together, tested
from calibration.diagnosis.scan import Signature, scan
from calibration.progress import Progress, silent
from qcar_twin.twin.mechanisms import offered
from qcar_twin.twin.mechanisms.base import Mechanism

_TRIED = 8  # of a scan's best that are refitted
_MOST = 8  # additions: more effects than any session was ever made with


@dataclasses.dataclass(frozen=True)
class Addition:
  """A named effect that is in a twin and not a form of a curve: its id, and the twin without it against the twin."""

  mechanism: str
  test: Test


def with_additions(trials: Trials, progress: Progress = silent) -> Trials:
  """A twin with the named effects, `forms`, that driving it was not fitted to bears out."""
  for found in range(_MOST):
    progress(f"named effects beside the maps, {found} found")
    larger = _next(trials)
    if larger is None:
      break
    trials = larger
  return trials


def _next(trials: Trials) -> Trials | None:
  """The twin with one named effect more; None where none is borne out."""
  problem, base, tried = trials.problem, trials.base, open_questions(trials)
  signatures = [s for s in scan(problem, base, tried).values() if s.testable and s.gain > 0.0]
  leading = sorted(signatures, key=lambda s: -s.gain)[:_TRIED]
  if not leading:
    return None
  models = fit_together(problem, [_started(trials, s) for s in leading])
  borne_out = [(m, test) for m in models if (test := tested(base, m, problem)).p_value * len(tried) < LEVEL]
  if not borne_out:
    return None
  return trials.going_on_from(max(borne_out, key=lambda found: found[1].nats)[0])


def open_questions(trials: Trials) -> list[Mechanism]:
  """Named effects that are not in the twin, that the recordings can show, and that no curve of it outlines."""
  inside = {*trials.beside, *trials.forms, trials.clock}
  fitted = trials.base.free
  return [
    m
    for m in offered(trials.problem.twin.vehicle.drive)
    if m.name not in inside
    and m.outlined_by not in trials.curves
    and not any(p.name in fitted for p in m.parameters if p.null is not None)
  ]


def _started(trials: Trials, signature: Signature) -> Candidate:
  """The model a scan's signature promises: the effect at its best size, the rest moved to meet it."""
  base = trials.base
  moved = {name: float(base.values[base.free.index(name)]) + by for name, by in signature.answer.items()}
  return trials.model((signature.mechanism,), moved | signature.start)
