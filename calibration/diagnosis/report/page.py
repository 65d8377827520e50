"""The report of a diagnosis: one HTML page, the verdict first, then where, what, how it helps, and what stays open."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.holdout_errors import ChannelFit, recovered_share
from calibration.diagnosis.outcome import Diagnosis, Outcome
from calibration.diagnosis.report import figures, wording
from calibration.diagnosis.report.curves import curve_chart
from calibration.diagnosis.report.demonstration import NOTHING_SHOWN, Demonstration, demonstrate
from calibration.diagnosis.report.document import REPORT, unknown_variables, write_document
from calibration.diagnosis.report.further import NOTHING_FURTHER, Further
from calibration.diagnosis.report.grounds import drive_next, effort, priors, unseen
from calibration.diagnosis.search.claims import Claim
from calibration.diagnosis.unexplained.leftover import PROPERTIES
from calibration.fitting.observations import CHANNELS
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.pages import Cell, Section, Table, write_page
from qcar_twin.pages.page import Figure, Tone
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.mechanisms.base import Mechanism

Array = NDArray[np.float64]
_TONES: dict[str, Tone] = {
  "no_mismatch": "good", "explained": "good", "partly_explained": "partly", "unexplained": "bad",
}  # fmt: skip
_SAID = {
  "no_mismatch": "nothing is missing", "explained": "explained", "partly_explained": "explained in part",
  "unexplained": "not explained",
}  # fmt: skip
_HELPS = 4  # sections up to "Before and after"


def write_diagnosis(
  outcome: Outcome, folder: str | Path, shown: Demonstration | None = None, further: Further = NOTHING_FURTHER
) -> Path:
  """Write diagnosis.json, report.html, twin.toml (the repaired twin) and recalibrated.toml (the one before it).

  Args:
    outcome: of `diagnose`.
    folder: for the results.
    shown: what was driven to be shown, where that was done before.
    further: what a later stage adds, its twin in the repaired one's place.

  Returns the report's path.
  """
  folder = Path(folder)
  claims = ", ".join(c.mechanism for c in outcome.diagnosis.decision.claims) or "no mechanism added"
  name = outcome.diagnosis.dataset
  save_twin(folder / "recalibrated.toml", outcome.twin, outcome.before, f"recalibrated on {name}, nothing added")
  repaired = (outcome.twin, outcome.after, f"repaired on {name}: {claims}")
  save_twin(folder / "twin.toml", *(further.twin or repaired))
  write_document(folder, outcome.diagnosis, further.curves)
  return write_report(folder, outcome.diagnosis, shown or demonstrate(outcome), further)


def write_report(
  folder: Path, diagnosis: Diagnosis, shown: Demonstration = NOTHING_SHOWN, further: Further = NOTHING_FURTHER
) -> Path:
  """Write report.html; returns its path."""
  sections = report_sections(diagnosis, shown)
  return write_page(
    folder / REPORT,
    f"Diagnosis of {diagnosis.dataset}",
    f"{verdict(diagnosis)} {further.sentence}".rstrip(),
    [*sections[:_HELPS], *further.sections, *sections[_HELPS:]],
    _subtitle(diagnosis),
    [*facts(diagnosis), *further.facts],
    _TONES[diagnosis.decision.verdict],
  )


def verdict(diagnosis: Diagnosis) -> str:
  """The verdict in plain words."""
  fits = diagnosis.holdout or diagnosis.validate
  recovered = recovered_share(fits) if fits else 0.0
  kept = recovered if diagnosis.holdout and recovered > 0.02 else None
  return wording.verdict_sentence(diagnosis.decision, _mechanisms(diagnosis), kept)


def something_nameless(diagnosis: Diagnosis) -> bool:
  """Whether something is left that no name on the base car's own laws explains."""
  return diagnosis.decision.verdict in ("unexplained", "partly_explained")


def facts(d: Diagnosis) -> list[tuple[str, str]]:
  """The numbers that go with the verdict."""
  rows = [("Verdict", _SAID[d.decision.verdict])]
  for claim in d.decision.claims[:2]:
    rows.append((f"Probability that it is {claim.mechanism}", f"{claim.probability:.2f}"))
  if d.decision.claims and (d.holdout or d.validate):
    kept = "recordings kept aside" if d.holdout else "validation recordings"
    rows.append(
      (f"Error above sensor noise removed, {kept}", f"{100 * recovered_share(d.holdout or d.validate):.0f} %")
    )
  if d.location.source != "residual" and d.location.channels:
    first, share = next(iter(d.location.channels.items()))
    rows.append(("Shows most in", f"{RESIDUALS[first].words} ({100 * share:.0f} %)"))
  return rows


def report_sections(d: Diagnosis, shown: Demonstration = NOTHING_SHOWN) -> list[Section]:
  """All sections in reading order."""
  return [
    _where(d, shown), _what(d), _model(d, shown), _errors(d), drive_next(d), unseen(d), priors(d), effort(d)
  ]  # fmt: skip


def _where(d: Diagnosis, shown: Demonstration) -> Section:
  place, observations = d.location, d.pool.problem.observations
  told = [f"{RESIDUALS[name].words} {100 * share:.0f} %" for name, share in place.channels.items() if share > 0.01]
  meaning = {
    "claim": "Evidence is what the claimed physics explains better than the recalibrated twin does",
    "unknown": "Evidence is what the best error without a name explains better than the recalibrated twin does",
    "residual": "Nothing is claimed; what is shown as evidence is where the recalibrated twin errs most",
  }[place.source]
  region = str(place.region).replace("^2", "²").replace("<=", "≤").replace("_", " ")
  text = (
    f"{meaning}, in nats: 1 nat makes it e times as likely, 10 nats 22 000 times.\n\n"
    + (f"* Part of the car: {place.subsystem}\n" if place.subsystem != "none" else "")
    + f"* Channels: {', '.join(told)}\n"
    + f"* Circumstances: {region} holds {100 * place.region.share:.0f} % of the evidence in"
    f" {100 * place.region.samples:.0f} % of the driving\n"
  )
  if shown.no_film:
    text += f"\n\n{shown.no_film}"
  spans = Table(
    "Seconds that carry most of the evidence",
    ("recording", "from [s]", "to [s]", "share [%]"),
    [(s.recording, round(s.start, 2), round(s.end, 2), round(100 * s.share, 1)) for s in place.time],
  )
  drawn: list[Figure | None] = [
    shown.clip,
    figures.explorer(d.pool, d.decision.model.residual, place),
    figures.channel_shares(place),
    figures.evidence_over_time(observations, place),
  ]
  return Section("Where", text, [spans], [f for f in drawn if f is not None])


def _what(d: Diagnosis) -> Section:
  claims, mechanisms = d.decision.claims, _mechanisms(d)
  lines = [f"* {wording.claim_sentence(c, mechanisms[c.mechanism])}{wording.doubts(c)}" for c in claims]
  text = "\n".join(lines) or "No mechanism is claimed."
  if d.decision.possible:
    text += f"\n\nVisible but too small to matter: {wording.listed(d.decision.possible)}."
  rivals = [(c.mechanism, name, round(nats, 1), "no" if name in c.equivalent_to else "yes")
            for c in claims for name, nats in c.rivals]  # fmt: skip
  columns = ("mechanism", "probability", "evidence [nats]", "held-out gain [nats]", "held-out t", "can't be told from")
  tables = [Table("Claims", columns, [_claim_row(c) for c in claims])] if claims else []
  if rivals:
    tables.append(Table("Rivals", ("instead of", "rival", "evidence [nats]", "can be told apart"), rivals))
  nameless, more = _nameless(d)
  drawn = [figures.ranked_evidence(d.decision)] if d.decision.ranking else []
  return Section("What", text + nameless, tables + more, drawn)


def _nameless(d: Diagnosis) -> tuple[str, list[Table]]:
  """What is known of an error without a name, where the verdict says that there is one."""
  if not something_nameless(d):
    return "", []
  text, tables = "", []
  if d.decision.leftovers:
    text += "\n\nWhat is left over is more than recordings without hidden effects show; how it behaves is listed below."
    rows: list[tuple[Cell, ...]] = [
      (RESIDUALS[i.channel].words, PROPERTIES[i.family], ", ".join(i.depends_on), round(i.nats, 2))
      for i in d.decision.leftovers
    ]
    tables.append(Table("What is left over", ("channel", "property", "follows", "per block of 3 s [nats]"), rows))
  if d.location.degrees:
    best = next(iter(d.location.degrees))
    text += (
      f"\n\nAn error without a name was tried in every place where one could act, as a smooth function of the motion."
      f" {wording.unknown_words('unknown_' + best).capitalize()} explains most."
    )
    found = [(wording.unknown_words("unknown_" + n), ", ".join(unknown_variables("unknown_" + n)), round(g, 1))
             for n, g in d.location.degrees.items()]  # fmt: skip
    tables.append(Table("Errors without a name", ("acts as", "smooth function of", "held-out gain [nats]"), found))
  return text, tables


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


def _model(d: Diagnosis, shown: Demonstration) -> Section:
  drawn = [curve_chart(shown.curves, figures.LABELS)] if shown.curves else []
  tables = [_forms(d, shown)] if shown.curves else []
  if not d.decision.claims:
    return Section("The model", "The twin stays as recalibrated; nothing is added.", tables, drawn)
  mechanisms = _mechanisms(d)
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
  return Section("The model", "\n".join(lines), [Table("Fitted parameters", columns, rows), *tables], drawn)


def _forms(d: Diagnosis, shown: Demonstration) -> Table:
  """The named forms that shape each curve: the base twin's, and the claims that act on the same part."""
  claimed = _mechanisms(d)
  rows = []
  for curve in shown.curves:
    acting = [name for name, m in claimed.items() if m.subsystem in curve.subsystems]
    rows.append((curve.heading, curve.form, wording.listed(acting) or "nothing"))
  return Table("Forms behind the curves", ("curve", "form", "changed by"), rows)


def effect_on_car(d: Diagnosis, name: str) -> str:
  """How much a claimed mechanism moves each channel here, after recalibration: "It moves yaw rate by …"."""
  model = d.decision.model
  without = d.pool.models.get(frozenset(model.mechanisms) - {name})
  if without is None or name not in model.mechanisms:
    return ""
  moved = channel_changes(d, model, without)
  top = sorted(moved, key=lambda n: -moved[n][1])[:3]
  told = ", ".join(f"{RESIDUALS[n].words} by {moved[n][0]:.2g} {RESIDUALS[n].symbol}" for n in top)
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
  chart = figures.before_and_after(shown, "recordings kept aside" if d.holdout else "validation recordings")
  return Section("Before and after", text, tables, [chart] if chart else [])


def _fit_table(caption: str, fits: Mapping[str, ChannelFit]) -> Table | None:
  rows = [(RESIDUALS[name].words, RESIDUALS[name].symbol, f.before, f.after, f.noise_floor, f.driving_noise,
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


def _mechanisms(d: Diagnosis) -> dict[str, Mechanism]:
  return {c.mechanism: d.pool.problem.mechanism(c.mechanism) for c in d.decision.claims}


def _subtitle(d: Diagnosis) -> str:
  observations = d.pool.problem.observations
  seconds = float(observations.stretches.segments.steps.sum()) * observations.stretches.segments.period
  return f"{len(observations.names)} recordings, {seconds:.0f} s of driving, {len(observations)} measured values"
