"""The report of a diagnosis: one HTML page, the errors first, then what was left out, what remains, and the grounds."""

from pathlib import Path

from calibration.diagnosis.decision.evidence import write_evidence
from calibration.diagnosis.formula.after import write_formula
from calibration.diagnosis.formula.report import formula_sections
from calibration.diagnosis.holdout_errors import recovered_share, share_taken_off
from calibration.diagnosis.outcome import Diagnosis, Outcome
from calibration.diagnosis.report import figures, wording
from calibration.diagnosis.report.belief import belief
from calibration.diagnosis.report.causes import claimed, left_out, unexplained, where
from calibration.diagnosis.report.curves import curve_chart
from calibration.diagnosis.report.demonstration import NOTHING_SHOWN, Demonstration, demonstrate
from calibration.diagnosis.report.document import REPORT, write_document
from calibration.diagnosis.report.errors import (
  errors,
  how_good_in_short,
  judged_on,
  multiples,
  parting,
  repaired,
  short_of,
)
from calibration.diagnosis.report.further import NOTHING_FURTHER, Further
from calibration.diagnosis.report.grounds import drive_next, effort, evidence, priors, unseen
from calibration.diagnosis.shipping import kind, recalibrated, shipped, warning
from calibration.fitting.residual_channels import RESIDUALS
from calibration.fitting.tolerances import unlike_the_class
from qcar_twin.pages import Cell, Section, Table, write_page
from qcar_twin.pages.page import Tone
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.posterior import save_posterior

_TONES: dict[str, Tone] = {
  "no_mismatch": "good", "explained": "good", "partly_explained": "partly", "unexplained": "bad",
}  # fmt: skip
_SAID = {
  "no_mismatch": "nothing is missing", "explained": "explained", "partly_explained": "explained in part",
  "unexplained": "not explained",
}  # fmt: skip
_FIRST = 5  # sections up to the repaired model; a later stage's come next


def write_diagnosis(
  outcome: Outcome, folder: str | Path, shown: Demonstration | None = None, further: Further = NOTHING_FURTHER
) -> Path:
  """Write diagnosis.json, evidence.json, posterior.json, report.html, recalibrated.toml and twin.toml (see `shipping`).

  Args:
    outcome: of `diagnose`.
    folder: for the results.
    shown: what was driven to be shown, where that was done before.
    further: what a later stage adds, its twin in the repaired one's place.

  Returns the report's path.
  """
  folder = Path(folder)
  name = outcome.diagnosis.dataset
  for file, one in (("recalibrated.toml", recalibrated(outcome)), ("twin.toml", further.twin or shipped(outcome))):
    save_twin(folder / file, one.twin, one.theta, one.note, one.command_shift)
  of = "curves" if further.twin else kind(outcome.diagnosis)
  write_formula(outcome.diagnosis.formula, folder, name, outcome.cut.command_shift)
  write_document(folder, outcome.diagnosis, further.curves, of, further.errors)
  write_evidence(folder, outcome.diagnosis.evidence)
  save_posterior(folder, belief(outcome.diagnosis))
  return write_report(folder, outcome.diagnosis, shown or demonstrate(outcome), further)


def write_report(
  folder: Path, diagnosis: Diagnosis, shown: Demonstration = NOTHING_SHOWN, further: Further = NOTHING_FURTHER
) -> Path:
  """Write report.html; returns its path."""
  sections = report_sections(diagnosis, shown, further)
  first = _FIRST + len(formula_sections(diagnosis.formula))
  return write_page(
    folder / REPORT,
    f"Diagnosis of {diagnosis.dataset}",
    f"{verdict(diagnosis)} {further.sentence}".rstrip(),
    [*sections[:first], *further.sections, *sections[first:]],
    _subtitle(diagnosis),
    [*facts(diagnosis), *(further.facts or _written(diagnosis))],
    _TONES[diagnosis.decision.verdict],
  )


def _written(diagnosis: Diagnosis) -> list[tuple[str, str]]:
  sentence = warning(diagnosis)
  return [("Written as twin.toml", sentence.removeprefix("twin.toml is ").rstrip("."))] if sentence else []


def verdict(diagnosis: Diagnosis) -> str:
  """The verdict in plain words: how good the twin is, what was left out of it, what is still unexplained; and, where
  something is, which figures of the car are unlike the class's, since what is left out may hide in them."""
  d, fits = diagnosis, judged_on(diagnosis)[0]
  recovered = recovered_share(d.holdout) if d.holdout else 0.0
  shares = {c.mechanism: share_taken_off(d.replay, fits, c.mechanism) if d.replay else None for c in d.decision.claims}
  taken = {name: share for name, share in shares.items() if share is not None}
  gain = recovered if recovered > 0.02 else None
  said = wording.verdict_sentence(d.decision, claimed(d), gain, taken, short_of(d))
  model = d.model
  unlike = wording.unlike_sentence(unlike_the_class(model.free, model.values)) if d.decision.nameless else ""
  apart = wording.departures_sentence(d.decision.departures, d.decision.claims)
  return f"{how_good_in_short(d)} {said}{apart}{unlike}".lstrip()


def facts(d: Diagnosis) -> list[tuple[str, str]]:
  """The numbers that go with the verdict."""
  rows = [("Verdict", _SAID[d.decision.verdict])]
  fits, whose = judged_on(d)
  seconds = parting(d)
  if seconds is not None:
    fit, channel = fits[seconds.channel], RESIDUALS[seconds.channel]
    size = f"{fit.before:.3g} → {fit.after:.3g}" if repaired(d) else f"{fit.before:.3g}"
    rows.append((f"Error of {channel.words}, {whose}", f"{size} {channel.symbol}"))
  if repaired(d) and fits:
    rows.append((f"Squared error above sensor noise removed, {whose}", f"{100 * recovered_share(fits):.0f} %"))
  if fits:
    rows.append(("What remains" if repaired(d) else "Errors", multiples(fits)))
  return rows


def report_sections(
  d: Diagnosis, shown: Demonstration = NOTHING_SHOWN, further: Further = NOTHING_FURTHER
) -> list[Section]:
  """All sections of the diagnosis itself in reading order."""
  first = [errors(d, further.errors), left_out(d), unexplained(d), *formula_sections(d.formula), where(d, shown)]
  return [*first, _model(d, shown), priors(d), evidence(d), drive_next(d), unseen(d), effort(d)]


def _model(d: Diagnosis, shown: Demonstration) -> Section:
  title = "The repaired model"
  drawn = [curve_chart(shown.curves, figures.LABELS)] if shown.curves else []
  tables = [_forms(d, shown)] if shown.curves else []
  if not d.decision.claims:
    return Section(title, "The twin stays as recalibrated; nothing is added.", tables, drawn)
  mechanisms = claimed(d)
  lines: list[str] = []
  rows: list[tuple[Cell, ...]] = []
  for claim in d.decision.claims:
    mechanism = mechanisms[claim.mechanism]
    lines.append(f"* {claim.mechanism}: {wording.equation(mechanism)}")
    for parameter in mechanism.parameters:
      row = claim.parameters.get(parameter.name, {})
      if row:
        value, std = float(row["value"]), float(row["std"])
        said = wording.amount(value, std, parameter.unit)
        meaning = parameter.description or parameter.name.replace("_", " ")
        rows.append((claim.mechanism, parameter.name, parameter.symbol, said, meaning))
  columns = ("mechanism", "parameter", "symbol", "value ± standard deviation", "meaning")
  return Section(title, "\n".join(lines), [Table("Fitted parameters", columns, rows), *tables], drawn)


def _forms(d: Diagnosis, shown: Demonstration) -> Table:
  """The named forms that shape each curve: the base twin's, and the claims that act on the same part."""
  mechanisms = claimed(d)
  rows = []
  for curve in shown.curves:
    acting = [name for name, m in mechanisms.items() if m.subsystem in curve.subsystems]
    rows.append((curve.heading, curve.form, wording.listed(acting) or "nothing"))
  return Table("Forms behind the curves", ("curve", "form", "changed by"), rows)


def _subtitle(d: Diagnosis) -> str:
  observations = d.pool.problem.observations
  seconds = float(observations.stretches.segments.steps.sum()) * observations.stretches.segments.period
  return f"{len(observations.names)} recordings, {seconds:.0f} s of driving, {len(observations)} measured values"
