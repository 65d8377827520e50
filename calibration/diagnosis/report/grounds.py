"""The second half of a diagnosis's page: what to drive next, what could not be seen, and the grounds in numbers."""

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.experiment import NOTHING
from calibration.diagnosis.outcome import Diagnosis
from calibration.diagnosis.report import wording
from calibration.diagnosis.report.document import parameter_shifts
from calibration.diagnosis.scan import confusion
from qcar_twin.pages import Section, Table


def drive_next(d: Diagnosis) -> Section:
  """The manoeuvre that would tell most."""
  if not d.next_experiment:
    return Section("What to drive next", "Nothing: no name is in doubt that another manoeuvre could settle.")
  one, other = ("no effect at all" if name == NOTHING else name for name in d.next_experiment["separates"])
  nats = d.next_experiment["predicted_nats"]
  text = (
    f"Drive {d.next_experiment['manoeuvre']}. It should tell {one} from {other}: about {nats:.0f} nats are expected"
    " of it."
  )
  return Section("What to drive next", text)


def priors(d: Diagnosis) -> Section:
  """What recalibration made of the parameters, beside what was measured of them."""
  base, model = d.pool.base, d.decision.model
  surprise = prior_shifts(base)
  rows = []
  for name, shift in parameter_shifts(base).items():
    final = model.estimate(name)[0] if name in model.free else None
    physical = base.free[name].null is None
    prior = shift["prior"] if physical else None
    std = float(base.free.std[base.free.index(name)]) if physical and base.free[name].std is not None else None
    fitted = (shift["fitted"], base.estimate(name)[1])
    rows.append((name, base.free[name].unit, prior, std, *fitted, surprise.get(name), final))
  text = (
    "An effect that recalibration absorbs leaves no error; it shows as a measured parameter that moved."
    " Parameters without a measured prior were free."
  )
  columns = ("parameter", "unit", "measured", "± std", "recalibrated", "± std ", "shift [std]", "with the claims")
  return Section("Parameters against their measurements", text, [Table("Base parameters", columns, rows)])


def unseen(d: Diagnosis) -> Section:
  """What these recordings could not have shown."""
  signatures = d.pool.signatures
  blind = sorted(s.mechanism for s in signatures.values() if not s.testable)
  text = (
    "These effects could not have been seen, because nothing in these recordings calls them up:"
    f" {wording.listed(blind)}. That does not mean that the car is free of them."
    if blind
    else "Every effect of the catalogue would have shown at its typical size."
  )
  rows = [(s.mechanism, round(100 * s.unabsorbed_share, 1), round(s.shown, 1), "yes" if s.testable else "no")
          for s in sorted(signatures.values(), key=lambda s: s.unabsorbed_share)]  # fmt: skip
  hidden = Table("Concealment: how much of each effect, at its typical size, recalibration cannot absorb",
                 ("mechanism", "survives [%]", "would show [nats]", "testable"), rows)  # fmt: skip
  pairs = sorted({tuple(sorted((a, b))): c for a, row in confusion(signatures).items() for b, c in row.items()}.items(),
                 key=lambda kv: -kv[1])  # fmt: skip
  alike = Table("Effects that look alike on these recordings", ("one", "other", "likeness (1: the same)"),
                [(a, b, round(c, 3)) for (a, b), c in pairs[:25]])  # fmt: skip
  return Section("What could not be seen", text, [hidden, *([alike] if pairs else [])])


def effort(d: Diagnosis) -> Section:
  """Wall time, and what the data set's reader was warned of."""
  rows = [(name, round(s, 1), round(100 * s / d.seconds, 1) if d.seconds else 0.0) for name, s in d.stages.items()]
  text = f"{d.seconds:.0f} s in all; {len(d.pool.models)} models were fitted."
  if d.notes:
    text += "\n\n" + "\n".join(f"* {note}" for note in d.notes)
  return Section(
    "Time and warnings", text, [Table("Wall time", ("stage", "seconds", "share [%]"), rows)] if rows else []
  )


def prior_shifts(base: Candidate) -> dict[str, float]:
  """(fitted - prior) / sqrt(prior variance - posterior variance) of parameters with a prior that the data inform.

  The difference counts as half the prior variance at least: the less the data say of a parameter, the farther the
  twin's own simplifications carry it, and the smaller is the deviation that a true shift would have.
  """
  out = {}
  for i, parameter in enumerate(base.free):
    if parameter.std is None or parameter.null is not None:  # a sensor's bias was never measured
      continue
    left = parameter.std**2 - base.std[i] ** 2
    if left > 0.05 * parameter.std**2:
      spread = np.sqrt(max(left, 0.5 * parameter.std**2))
      out[parameter.name] = float((base.values[i] - parameter.nominal) / spread)
  return out
