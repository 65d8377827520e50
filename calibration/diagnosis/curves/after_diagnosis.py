"""Free curves as a stage after a diagnosis: where the base car's own laws leave something that has no name."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from calibration.diagnosis.curves.report import wording
from calibration.diagnosis.curves.report.page import sections
from calibration.diagnosis.curves.report.shapes import Shape, shapes
from calibration.diagnosis.curves.study import Study, sentences, study
from calibration.diagnosis.holdout_errors import ChannelFit, ratio
from calibration.diagnosis.outcome import Diagnosis, Outcome
from calibration.diagnosis.report.demonstration import demonstrate
from calibration.diagnosis.report.errors import error_lines, repaired
from calibration.diagnosis.report.further import Further
from calibration.diagnosis.report.page import write_diagnosis
from calibration.diagnosis.report.wording import listed
from calibration.diagnosis.shipping import (
  JUDGING,
  Judged,
  judge,
  kind,
  recalibrated,
  shipped,
  warning,
  worse_clauses,
)
from calibration.diagnosis.staged import Staged
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.fitting.residual_channels import RESIDUALS
from calibration.log_check.ready import ready
from calibration.progress import Progress, silent
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.engines import EngineKind
from qcar_twin.twin.file import save_twin

Fits = Mapping[str, ChannelFit]
When = Literal["auto", "never", "always"]
_DIAGNOSED, _CURVED = "diagnosed.toml", "characterised.toml"  # the two twins that are compared
_ADVICE = (
  "something is left that no name explains: the maps themselves may differ from the twin's laws; try --curves auto"
)


def wanted(when: When, diagnosis: Diagnosis) -> bool:
  """Whether curves are fitted: "auto" where something is left that no name explains."""
  return when == "always" or (when == "auto" and diagnosis.decision.nameless)


def write_with_curves(
  outcome: Outcome,
  dataset: DataSet,
  folder: Path,
  when: When = "auto",
  most: float = LONGEST,
  threads: int = 0,
  progress: Progress = silent,
  plant: EngineKind = "reduced",
) -> tuple[Path, list[str]]:
  """Write a diagnosis, fit free curves where they are wanted, and write it again with them.

  The diagnosis is written before anything else begins, and stands where curves can't be fitted. Where they are,
  diagnosed.toml and characterised.toml are the two twins that were compared, and twin.toml is the better one
  (`shipping`).

  Args:
    outcome: of `diagnose` on the data set.
    dataset: as it was loaded.
    folder: for the results.
    when: curves are fitted.
    most: s of driving that are simulated for them.
    threads: of the simulation, 0 for all cores.
    progress: reports the stage.
    plant: what curves are fitted on.

  Returns:
    the report's path, and what the terminal says of the curves, a line a finding.
  """
  progress("film and report")
  shown = demonstrate(outcome)
  page = write_diagnosis(outcome, folder, shown)
  for file in (_DIAGNOSED, _CURVED):  # of an earlier run
    (folder / file).unlink(missing_ok=True)
  Staged(folder).end()
  if not wanted(when, outcome.diagnosis):
    lines = [warning(outcome.diagnosis), _ADVICE if outcome.diagnosis.decision.nameless else ""]
    return page, [*error_lines(outcome.diagnosis), *(line for line in lines if line)]
  try:
    found = study(dataset, most, threads, lambda stage, share=None: progress(f"free curves: {stage}", share), plant)
  except ValueError as error:
    further = Further(f"Free curves could not be fitted, and the diagnosis stands without them: {error}")
    said = [*error_lines(outcome.diagnosis), further.sentence]
    return write_diagnosis(outcome, folder, shown, further), said
  judged, against = judged_with_curves(found, outcome, ready(dataset)[0])
  further = with_curves(found, outcome.diagnosis, against, {role: row.fits for role, row in judged.items()})
  page = write_diagnosis(outcome, folder, shown, further)
  how = "repaired" if repaired(outcome.diagnosis) else "recalibrated"
  note, shift = f"{how} on {found.dataset}, without curves", outcome.cut.command_shift
  save_twin(folder / _DIAGNOSED, outcome.twin, outcome.after, note, shift)
  curved = found.shipped
  save_twin(folder / _CURVED, curved.twin, curved.theta, curved.note, curved.command_shift)
  table = error_lines(outcome.diagnosis, further.errors)
  return page, [*sentences(found, holdout=False), *table, chosen(found, outcome.diagnosis, against)]


def judged_with_curves(found: Study, outcome: Outcome, dataset: DataSet) -> tuple[dict[str, Judged], tuple[str, ...]]:
  """The twin with curves as it would be written against the recalibrated one, by role; what speaks against it.

  On recordings that judged it stands as it was before it was fitted to them.
  Against it speak what would against a repair (`shipping.objections`), and channels that lose more against the twin
  that is written without it than all gain (`Judged.losing`).
  """
  curved = {"validate": found.unseen, "holdout": found.shipped}
  base, without = recalibrated(outcome), shipped(outcome)
  roles = {role: judge(base, curved[role], dataset.role(role)) for role in JUDGING}
  against = [clause for role, judged in roles.items() for clause in (*worse_clauses(role, judged.fits), *judged.slow)]
  losing = dict.fromkeys(c for role in JUDGING for c in judge(without, curved[role], dataset.role(role)).losing)
  if losing:
    against.append(f"the errors of {listed([RESIDUALS[channel].words for channel in losing])} grow")
  return roles, tuple(dict.fromkeys(against))


def with_curves(
  found: Study, diagnosis: Diagnosis, against: Sequence[str] = (), errors: Mapping[str, Fits] | None = None
) -> Further:
  """What the curves add to a diagnosis.

  Args:
    against: what speaks against the twin with curves, see `judged_with_curves`.
    errors: of the recalibrated twin and of that with curves, by role and channel.
  """
  drawn = shapes(found.found, found.outlines)
  repaired = {role: {n: f.after for n, f in getattr(diagnosis, role).items()} for role in ("holdout", "validate")}
  parts = sections(found, drawn, repaired, "Free curves: ")
  last = parts.pop()
  parts.append(dataclasses.replace(last, text=f"{chosen(found, diagnosis, against)}\n\n{last.text}"))
  curved = curves_are_better(found, diagnosis, against)
  return Further(
    sentence(found, diagnosis, drawn),
    [("twin.toml is", f"the {'twin with curves' if curved else _without(diagnosis)}")],
    parts,
    found.document(),
    found.shipped if curved else None,
    errors or {},
  )


def sentence(found: Study, diagnosis: Diagnosis, drawn: tuple[Shape, ...]) -> str:
  """What the curves found, and how far the errors fell from stage to stage."""
  said = wording.departures(found, drawn)
  return f"Free curves were fitted over the twin's maps. {said} {fall(found, diagnosis)}".rstrip()


def fall(found: Study, diagnosis: Diagnosis) -> str:
  """Errors from the base over the diagnosed twin to the twin with curves, on recordings that took no part."""
  fits, after = diagnosis.holdout, found.errors.get(found.best, {})
  where = "held-out recordings"
  if not (fits and after):
    fits, after, where = diagnosis.validate, found.judged.get(found.best, {}), "validation recordings"
  if not (fits and after):
    return ""
  before = {name: fit.before for name, fit in fits.items()}
  repaired = {name: fit.after for name, fit in fits.items()}
  return (
    f"On {where} the errors go from 100 % for the recalibrated base to {100.0 * ratio(repaired, before):.0f} % after"
    f" the diagnosis and {100.0 * ratio(after, before):.0f} % with curves (geometric mean over the channels)."
  )


def curves_are_better(found: Study, diagnosis: Diagnosis, against: Sequence[str] = ()) -> bool:
  """Whether curves are written: they err less on recordings that only judge, and nothing speaks against them."""
  return _on_validation(found, diagnosis) < 1.0 and not against


def chosen(found: Study, diagnosis: Diagnosis, against: Sequence[str] = ()) -> str:
  """Which twin is written as twin.toml, and why."""
  without = f"twin.toml is the {_without(diagnosis)}"
  if not (found.judged and diagnosis.validate):
    return f'{without}: no recordings only judge (role "validate"), so curves are not trusted.'
  share = 100.0 * (_on_validation(found, diagnosis) - 1.0)
  size = f"{abs(share):.1f} % {'smaller' if share < 0.0 else 'larger'} than the {_without(diagnosis)}'s"
  if against:
    return f"{without}: with curves the errors on validation recordings are {size}, but {'; '.join(against)}."
  which = "twin.toml is the twin with curves" if curves_are_better(found, diagnosis) else without
  return f"{which}: with curves the errors on validation recordings are {size}."


def _without(diagnosis: Diagnosis) -> str:
  return f"{kind(diagnosis)} twin"


def _on_validation(found: Study, diagnosis: Diagnosis) -> float:
  key = "before" if kind(diagnosis) == "recalibrated" else "after"
  without: Mapping[str, float] = {name: getattr(fit, key) for name, fit in diagnosis.validate.items()}
  return ratio(found.judged.get(found.best, {}), without)
