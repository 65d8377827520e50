"""The report of a diagnosis: one HTML page, the verdict first, then where, what, how it helps, and what stays open."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.detect import prior_shifts
from calibration.diagnosis.experiment import NOTHING
from calibration.diagnosis.holdout_errors import ChannelFit, recovered_share
from calibration.diagnosis.outcome import Diagnosis, Outcome
from calibration.diagnosis.report import figures, wording
from calibration.diagnosis.report.document import FIGURES, REPORT, parameter_shifts, unknown_variables, write_document
from calibration.diagnosis.scan import confusion
from calibration.diagnosis.search.claims import Claim
from calibration.diagnosis.unexplained.leftover import PROPERTIES
from calibration.fitting.observations import CHANNELS, UNITS
from calibration.reports import Picture, Section, Table, picture, write_page
from qcar_twin.atomic_io import whole_file
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.mechanisms.base import Mechanism

Array = NDArray[np.float64]


def write_diagnosis(outcome: Outcome, folder: str | Path) -> Path:
  """Write diagnosis.json, report.html with its figures, twin.toml (the repaired twin) and recalibrated.toml (the same
  before the repair); returns the report's path."""
  folder = Path(folder)
  claims = ", ".join(c.mechanism for c in outcome.diagnosis.decision.claims) or "no mechanism added"
  name = outcome.diagnosis.dataset
  save_twin(folder / "recalibrated.toml", outcome.twin, outcome.before, f"recalibrated on {name}, nothing added")
  save_twin(folder / "twin.toml", outcome.twin, outcome.after, f"repaired on {name}: {claims}")
  write_document(folder, outcome.diagnosis)
  return write_report(folder, outcome.diagnosis)


def write_report(folder: Path, diagnosis: Diagnosis) -> Path:
  """Write report.html and, beside it, its figures as files; returns the page's path."""
  sections = report_sections(diagnosis)
  pictures = [p for section in sections for p in section.figures]
  for number, item in enumerate(pictures, start=1):
    target = folder / FIGURES / f"{number:02d}_{_slug(item.caption)}.{item.kind}"
    with whole_file(target) as part:
      part.write_bytes(item.image)
  return write_page(
    folder / REPORT, f"Diagnosis of {diagnosis.dataset}", verdict(diagnosis), sections, _subtitle(diagnosis)
  )


def verdict(diagnosis: Diagnosis) -> str:
  """The verdict in plain words."""
  fits = diagnosis.holdout or diagnosis.validate
  recovered = recovered_share(fits) if fits else 0.0
  kept = recovered if diagnosis.holdout and recovered > 0.02 else None
  return wording.verdict_sentence(diagnosis.decision, _mechanisms(diagnosis), kept)


def report_sections(diagnosis: Diagnosis) -> list[Section]:
  """All sections in reading order."""
  return [
    _where(diagnosis),
    _what(diagnosis),
    _model(diagnosis),
    _errors(diagnosis),
    _priors(diagnosis),
    _blind_spots(diagnosis),
    _alarms(diagnosis),
    _effort(diagnosis),
  ]


def _where(d: Diagnosis) -> Section:
  place, observations = d.location, d.pool.problem.observations
  after = d.decision.model.residual
  channels = ", ".join(f"{name} {100 * share:.0f} %" for name, share in place.channels.items() if share >= 0.01)
  meaning = {
    "claim": "Evidence is what the claimed physics gains over the recalibrated twin.",
    "unknown": "Evidence is what the best nameless error gains over the recalibrated twin.",
    "residual": "Nothing is claimed; shown is where the recalibrated twin's error is largest.",
  }[place.source]
  text = (
    f"{meaning}\n\n* Subsystem: {place.subsystem}\n* Channels: {channels}\n"
    f"* Circumstances: {place.region} holds {100 * place.region.share:.0f} % of the evidence"
    f" in {100 * place.region.samples:.0f} % of the driving\n"
  )
  if place.degree:
    text += f"* A nameless error would have to be {wording.unknown_words('unknown_' + place.degree)}\n"
  left = Table(
    "What the model behind the verdict leaves over, beyond what recordings without hidden effects show",
    ("channel", "property", "follows", "per block of 3 s [nats]"),
    [(i.channel, PROPERTIES[i.family], ", ".join(i.depends_on), round(i.nats, 2)) for i in d.decision.leftovers],
  )
  spans = Table(
    "Seconds that carry most of the evidence",
    ("recording", "from [s]", "to [s]", "share [%]"),
    [(s.recording, round(s.start, 2), round(s.end, 2), round(100 * s.share, 1)) for s in place.time],
  )
  pictures = _pictures(
    (figures.traces(d.pool, after, place), "Measured, before and after; seconds that carry evidence are shaded"),
    (figures.evidence_over_time(observations, place), "Evidence through the recordings"),
    (figures.drive_map(observations, place), "Map of the drive, coloured by mismatch"),
  )
  return Section("Where", text, [spans, *([left] if d.decision.leftovers else []), *_degrees(d)], pictures)


def _degrees(d: Diagnosis) -> list[Table]:
  if not d.location.degrees:
    return []
  rows = [(wording.unknown_words("unknown_" + n), ", ".join(unknown_variables("unknown_" + n)), round(g, 1))
          for n, g in d.location.degrees.items()]  # fmt: skip
  return [Table("Nameless errors, for comparison", ("acts as", "smooth function of", "held-out gain [nats]"), rows)]


def _what(d: Diagnosis) -> Section:
  claims, mechanisms = d.decision.claims, _mechanisms(d)
  lines = [f"* {wording.claim_sentence(c, mechanisms[c.mechanism])}{wording.doubts(c)}" for c in claims]
  text = "\n".join(lines) or "No mechanism is claimed."
  if d.decision.possible:
    text += f"\n\nVisible but too small to matter: {wording.listed(d.decision.possible)}."
  if d.decision.unknown:
    name, held = d.decision.unknown
    text += (
      f"\n\nThe best nameless rival is {wording.unknown_words(name)}: {held.gain:.0f} nats held out, t = {held.t:.1f}."
    )
  rivals = [(c.mechanism, name, round(nats, 1), "no" if name in c.equivalent_to else "yes")
            for c in claims for name, nats in c.rivals]  # fmt: skip
  columns = ("mechanism", "probability", "evidence [nats]", "held-out gain [nats]", "held-out t", "can't be told from")
  tables = [Table("Claims", columns, [_claim_row(c) for c in claims])] if claims else []
  if rivals:
    tables.append(Table("Rivals", ("instead of", "rival", "evidence [nats]", "can be told apart"), rivals))
  chart = _pictures(
    (figures.ranked_evidence(d.decision), "Evidence per mechanism, best first; hatched: not told apart")
  )
  return Section("What", text, tables, chart if d.decision.ranking else [])


def _claim_row(c: Claim) -> tuple[str | float, ...]:
  equal = wording.listed(c.equivalent_to) or "–"
  return (
    c.mechanism,
    round(c.probability, 2),
    round(c.evidence_nats, 1),
    round(c.held_out.gain, 1),
    round(c.held_out.t, 1),
    equal,
  )


def _model(d: Diagnosis) -> Section:
  mechanisms = _mechanisms(d)
  if not d.decision.claims:
    return Section("The model", "The twin stays as recalibrated; nothing is added.")
  lines, rows = [], []
  for claim in d.decision.claims:
    mechanism = mechanisms[claim.mechanism]
    lines.append(f"* {claim.mechanism}: {wording.equation(mechanism)} {effect_on_car(d, claim.mechanism)}".rstrip())
    for parameter in mechanism.parameters:
      row = claim.parameters.get(parameter.name, {})
      if row:
        value, std, unit = float(row["value"]), float(row["std"]), parameter.unit
        said = wording.amount(value, std, unit)
        rows.append((claim.mechanism, parameter.name, parameter.symbol, value, std, unit, said, parameter.description))
  columns = ("mechanism", "parameter", "symbol", "value", "std", "unit", "in words", "meaning")
  return Section("The model", "\n".join(lines), [Table("Fitted parameters", columns, rows)])


def effect_on_car(d: Diagnosis, name: str) -> str:
  """How much a claimed mechanism moves each channel here, after recalibration: "It moves yaw rate by …"."""
  model = d.decision.model
  without = d.pool.models.get(frozenset(model.mechanisms) - {name})
  if without is None or name not in model.mechanisms:
    return ""
  moved = channel_changes(d, model, without)
  top = sorted(moved, key=lambda n: -moved[n][1])[:3]
  told = ", ".join(f"{n.replace('_', ' ')} by {moved[n][0]:.2g} {UNITS[n]}" for n in top)
  return f"On these recordings it moves {told} (root mean square)."


def channel_changes(d: Diagnosis, one: Candidate, other: Candidate) -> dict[str, tuple[float, float]]:
  """Per channel: RMS difference of two models in the channel's unit, and in nats per value."""
  observations = d.pool.problem.observations
  whitened = one.residual - other.residual
  raw = whitened / d.pool.problem.whiten(np.ones(len(observations)))
  out = {}
  for index in np.unique(observations.channel):
    rows = observations.channel == index
    out[CHANNELS[index]] = (float(np.sqrt(np.mean(raw[rows] ** 2))), float(np.mean(whitened[rows] ** 2)))
  return out


def _errors(d: Diagnosis) -> Section:
  tables = [t for t in (_fit_table("Hold-out, opened once", d.holdout), _fit_table("Validation", d.validate)) if t]
  if not tables:
    return Section("Before and after", "No recordings were kept aside, so nothing can be shown.")
  text = (
    "Before is the recalibrated twin, never an uncalibrated one; after is the repaired twin. Errors are root mean"
    " squares of simulated stretches in each channel's unit; the noise floor is the sensor's own at"
    " standstill, the noise while driving what no smooth motion makes."
  )
  shown = d.holdout or d.validate
  share = recovered_share(shown)
  if d.decision.claims:
    above = "Of the squared error above the noise while driving, every channel with the same weight,"
    gone = f"{above} {100 * share:.0f} % is gone."
    text += f"\n\n{gone if share > 0 else 'The repair does not lower the error on these recordings.'}"
  chart = _pictures(
    (figures.before_and_after(shown), "Errors before and after in multiples of the noise, with 95 % bounds")
  )
  return Section("Before and after", text, tables, chart)


def _fit_table(caption: str, fits: Mapping[str, ChannelFit]) -> Table | None:
  rows = [(name, f.unit, f.before, f.after, f.noise_floor, f.driving_noise,
           100 * (f.after / f.before - 1.0) if f.before else 0.0,
           f"{100 * f.ci95[0]:+.1f} to {100 * f.ci95[1]:+.1f}") for name, f in fits.items()]  # fmt: skip
  columns = (
    "channel",
    "unit",
    "before",
    "after",
    "noise floor",
    "noise while driving",
    "change [%]",
    "95 % interval [%]",
  )
  return Table(caption, columns, rows) if rows else None


def _priors(d: Diagnosis) -> Section:
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


def _blind_spots(d: Diagnosis) -> Section:
  signatures = d.pool.signatures
  blind = sorted(s.mechanism for s in signatures.values() if not s.testable)
  text = "* Not testable on these recordings: " + (wording.listed(blind) or "none")
  text += "\n* Not testable does not mean absent: these manoeuvres don't excite them."
  if d.next_experiment:
    one, other = ("no effect at all" if name == NOTHING else name for name in d.next_experiment["separates"])
    text += f"\n* Drive next: {d.next_experiment['manoeuvre']}."
    text += f" It should tell {one} from {other} by about {d.next_experiment['predicted_nats']:.0f} nats"
  rows = [(s.mechanism, round(100 * s.unabsorbed_share, 1), round(s.shown, 1), "yes" if s.testable else "no")
          for s in sorted(signatures.values(), key=lambda s: s.unabsorbed_share)]  # fmt: skip
  hidden = Table("Concealment: how much of each effect, at its typical size, recalibration cannot absorb",
                 ("mechanism", "survives [%]", "would show [nats]", "testable"), rows)  # fmt: skip
  pairs = sorted({tuple(sorted((a, b))): c for a, row in confusion(signatures).items() for b, c in row.items()}.items(),
                 key=lambda kv: -kv[1])  # fmt: skip
  alike = Table("Effects that look alike on these recordings", ("one", "other", "likeness (1: the same)"),
                [(a, b, round(c, 3)) for (a, b), c in pairs[:25]])  # fmt: skip
  return Section("What these recordings can't show", text, [hidden, *([alike] if pairs else [])])


def _alarms(d: Diagnosis) -> Section:
  rows = [
    (x.name, round(x.statistic, 3), x.threshold, "alarm" if x.alarm else "quiet", x.sentence)
    for x in d.detection.detectors
  ]
  text = "Four signs that do not depend on any named physics; sessions without hidden effects stay below the levels."
  return Section("Detectors", text, [Table("", ("detector", "statistic", "level", "state", "meaning"), rows)])


def _effort(d: Diagnosis) -> Section:
  rows = [(name, round(s, 1), round(100 * s / d.seconds, 1) if d.seconds else 0.0) for name, s in d.stages.items()]
  text = f"{d.seconds:.0f} s in all; {len(d.pool.models)} models were fitted."
  if d.notes:
    text += "\n\n" + "\n".join(f"* {note}" for note in d.notes)
  return Section(
    "Time and warnings", text, [Table("Wall time", ("stage", "seconds", "share [%]"), rows)] if rows else []
  )


def _pictures(*pairs: tuple[Figure | None, str]) -> list[Picture]:
  return [picture(figure, caption) for figure, caption in pairs if figure is not None]


def _mechanisms(d: Diagnosis) -> dict[str, Mechanism]:
  return {c.mechanism: d.pool.problem.mechanism(c.mechanism) for c in d.decision.claims}


def _subtitle(d: Diagnosis) -> str:
  observations = d.pool.problem.observations
  seconds = float(observations.stretches.segments.steps.sum()) * observations.stretches.segments.period
  return f"{len(observations.names)} recordings, {seconds:.0f} s of driving, {len(observations)} measured values"


def _slug(caption: str) -> str:
  words = "".join(c if c.isalnum() else " " for c in caption.lower()).split()
  return "_".join(words[:4])
