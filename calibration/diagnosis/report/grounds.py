"""The second half of a diagnosis's page: parameters, evidence, what to drive next, what the recordings cannot show."""

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.decision.departures import Departure
from calibration.diagnosis.experiment import NOTHING
from calibration.diagnosis.outcome import Diagnosis
from calibration.diagnosis.report import figures, wording
from calibration.diagnosis.report.document import LISTED, parameter_shifts
from calibration.diagnosis.scan import confusion
from calibration.diagnosis.score import clustered_std
from qcar_twin.pages import Cell, Section, Table
from qcar_twin.pages.numbers import spread

_AT_BOUND = 1e-6  # of a parameter's range: nearer than that it is at its bound


def drive_next(d: Diagnosis) -> Section:
  """The manoeuvre that would settle most."""
  title = "What to drive next"
  if not d.next_experiment:
    return Section(title, "Nothing: no manoeuvre is known that would settle a name in doubt.")
  one, other = ("no effect at all" if name == NOTHING else name for name in d.next_experiment["separates"])
  nats = d.next_experiment["predicted_nats"]
  text = (
    f"Drive {d.next_experiment['manoeuvre']}. It should distinguish {one} from {other}, with an expected evidence of"
    f" about {nats:.0f} nats."
  )
  return Section(title, text)


def evidence(d: Diagnosis) -> Section:
  """Evidence of every mechanism, the only place where the page counts in nats."""
  text = (
    "Evidence says how much likelier the recordings are with a mechanism than without it. It is the natural logarithm"
    " of that factor, and its unit is the nat: 1 nat is a factor of 2.7, 10 nats are a factor of 22 000. The evidence"
    " of a claim is against the twin without it, that of any other mechanism against the recalibrated twin."
  )
  alternatives = [(c.mechanism, name, round(nats, 1), "yes" if name in c.indistinguishable_from else "no")
                  for c in d.decision.claims for name, nats in c.alternatives[:LISTED]]  # fmt: skip
  columns = ("instead of", "alternative", "evidence [nats]", "indistinguishable")
  tables = [Table("Alternatives to the claims", columns, alternatives)] if alternatives else []
  drawn = [figures.ranked_evidence(d.decision)] if d.decision.ranking else []
  return Section("The evidence in numbers", text, tables, drawn)


def priors(d: Diagnosis) -> Section:
  """What the fit made of the parameters, against what was measured of them before."""
  base, model = d.pool.base, d.model
  deviations = lambda m: dict(zip(m.free.names, clustered_std(m, d.pool.problem.observations).tolist(), strict=True))
  first, last = deviations(base), {} if model is base else deviations(model)
  apart = {x.name: x for x in d.decision.departures}
  rows: list[tuple[Cell, ...]] = []
  for name, shift in parameter_shifts(base).items():
    parameter = base.free[name]
    known = parameter.null is None and parameter.std is not None
    prior = spread(shift["prior"], parameter.std) if known else "–"
    final = spread(model.value(name), last[name]) if name in last else "–"
    shown, shifted = spread(shift["fitted"], first[name]), shift["sigma"] if known else None
    rows.append((name, parameter.unit, prior, shown, shifted, final, _remark(base, name, apart.get(name))))
  text = (
    "An effect that recalibration absorbs leaves no error. It shows as a measured parameter that moved. The shift is"
    " the fitted value minus the measured one, in standard deviations of the measurement. A dash marks a parameter that"
    " was not measured. The deviation of a fitted value is by the scatter of recordings. A twin's parameters move on"
    " cars without any effect, too, since it is no more than a model. How far is known from such cars, and a parameter"
    " that moved farther contradicts what was known of it."
  )
  flagged = [f"* {row[0]}: {row[-1]}." for row in rows if row[-1]]
  if flagged:
    text += "\n\nThese parameters need a look:\n" + "\n".join(flagged)
  columns = ("parameter", "unit", "measured ±", "recalibrated ±", "shift", "repaired ±", "remark")
  return Section("Parameters and how far they moved", text, [Table("Parameters", columns, rows, unfolded=True)])


def _remark(base: Candidate, name: str, apart: Departure | None) -> str:
  """What a reader must know of a fitted parameter: that it ended at its bound, or contradicts what was known of it."""
  parameter, value = base.free[name], float(base.values[base.free.index(name)])
  parts = []
  if min(value - parameter.lower, parameter.upper - value) <= _AT_BOUND * (parameter.upper - parameter.lower):
    end = "lower" if value - parameter.lower < parameter.upper - value else "upper"
    parts.append(f"at its {end} bound, so its deviation says little")
  if apart is not None:
    known = "is usual" if apart.usual else "was measured"
    parts.append(f"contradicts what {known}, by {abs(apart.z):.1f} deviations of it and of the twin together")
  return "; ".join(parts)


def unseen(d: Diagnosis) -> Section:
  """Effects that these recordings cannot show, or that recalibration hides."""
  signatures = d.pool.signatures
  blind = sorted(s.mechanism for s in signatures.values() if not s.testable)
  text = (
    f"These recordings cannot show {wording.listed(blind)}. They hardly excite these effects, lack a channel that would"
    " show them, or recalibration absorbs them. That does not mean that the car is free of them."
    if blind
    else "Every effect of the catalogue would have shown at its typical size."
  )
  rows = [(s.mechanism, round(100 * s.unabsorbed_share, 1), round(s.shown, 1), "yes" if s.testable else "no")
          for s in sorted(signatures.values(), key=lambda s: s.unabsorbed_share)]  # fmt: skip
  hidden = Table("How much of each effect, at its typical size, recalibration cannot absorb",
                 ("mechanism", "not absorbed [%]", "evidence [nats]", "testable"), rows)  # fmt: skip
  pairs = sorted({tuple(sorted((a, b))): c for a, row in confusion(signatures).items() for b, c in row.items()}.items(),
                 key=lambda kv: -kv[1])  # fmt: skip
  similar = Table("Effects that look similar on these recordings", ("one", "other", "correlation"),
                  [(a, b, round(c, 3)) for (a, b), c in pairs[:25]])  # fmt: skip
  text += (
    " The second table predicts, to first order, how small an effect would have been found. From that size on it would"
    " be claimed more often than not."
  )
  return Section("What these recordings cannot show", text, [hidden, could_find(d), *([similar] if pairs else [])])


def could_find(d: Diagnosis) -> Table:
  """From which size on each mechanism that is not claimed would have been."""
  claimed = {c.mechanism for c in d.decision.claims}
  found = [x for name, x in sorted(d.detectable.items()) if name not in claimed]
  shown = lambda value: "never" if value is None else f"{value:.2g}"
  rows = [
    (x.mechanism, x.parameter, shown(x.size), shown(x.named), x.unit, None if x.share is None else round(100 * x.share))
    for x in sorted(found, key=lambda x: (x.share is None, x.share or 0.0, x.mechanism))
  ]
  heads = ("mechanism", "parameter", "claimed from", "by its own name from", "unit", "of its typical size [%]")
  return Table("How small an effect this driving would have shown", heads, rows)


def effort(d: Diagnosis) -> Section:
  """Wall time, and warnings about the data set."""
  rows = [(name, round(s, 1), round(100 * s / d.seconds, 1) if d.seconds else 0.0) for name, s in d.stages.items()]
  text = f"The diagnosis took {d.seconds:.0f} s and fitted {len(d.pool.models)} models."
  if d.notes:
    text += "\n\n" + "\n".join(f"* {note}" for note in d.notes)
  return Section(
    "Time and warnings", text, [Table("Wall time", ("stage", "seconds", "share [%]"), rows)] if rows else []
  )
