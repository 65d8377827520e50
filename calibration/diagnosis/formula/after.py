"""A formula as a stage of a diagnosis: only where something stays unexplained, and never in the way of the verdict."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.formula.finding import Found, find_formula
from calibration.diagnosis.formula.looking import STAGE
from calibration.diagnosis.formula.minimum import at_minimum, thinned
from calibration.diagnosis.formula.words import alike_words
from calibration.diagnosis.holdout_errors import ChannelFit, change, compare_twins
from calibration.diagnosis.pool import Pool
from calibration.fitting.likelihood import Problem, weighting_from
from calibration.fitting.slopes import NotFinite
from calibration.fitting.windows import Cut
from calibration.progress import Progress, silent
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.formula.written import write_mechanism

TWIN = "twin_with_formula.toml"


@dataclasses.dataclass(frozen=True)
class Shipped:
  """What was found for the unexplained rest, and what it does on recordings that took no part.

  Attributes:
    rest: where it acts, and its formula or table.
    holdout: errors of the repaired twin, before, and of the same with the formula, after, per channel; empty where
      nothing is shipped.
  """

  rest: Found
  holdout: Mapping[str, ChannelFit]

  @property
  def kept(self) -> bool:
    """Whether files are written: there is one, and held-out recordings do not speak against it."""
    return bool(self.rest.kind) and self.change <= 1.0

  @property
  def change(self) -> float:
    """Geometric mean over the channels of the held-out errors, after over before; 1 without any."""
    return change(self.holdout)


def formula_left(
  pool: Pool, decision: Decision, recordings: Sequence[Recording], cut: Cut, progress: Progress = silent
) -> Shipped:
  """The formula of what the model behind the claims leaves unexplained, or why there is none: the verdict stands.

  Args:
    pool: all fitted models.
    decision: with its verdict.
    recordings: held-out ones, for the errors.
    cut: how they are cut.
    progress: reports the share that is done.
  """
  progress(STAGE, 0.0)
  part, model = thinned(pool.problem, pool.model(decision.mechanisms), judges=True)
  try:
    problem, winner = at_minimum(*weighed(*at_minimum(part, model), pool.floor))
    found = find_formula(problem, winner, model, pool.priors, progress=progress)
  except (np.linalg.LinAlgError, NotFinite) as error:
    return Shipped(Found(None, (), "", f"the search for one broke off ({error})", None, 0.0), {})
  if not (found.kind and found.twin):
    return Shipped(found, {})
  tried = found.twin
  # the twin that ships, not its refit to part of the driving
  before = tried.problem.parameters.vector(pool.problem.exact.parameters.named(model.theta))
  fits, _ = compare_twins(tried.problem.twin, before, tried.theta, recordings, pool.floor, cut)
  return Shipped(found, fits)


def weighed(problem: Problem, model: Candidate, floor: Mapping[str, float]) -> tuple[Problem, Candidate]:
  """The same with weights from what the model leaves over: what it explains is not its channels' noise."""
  raw = problem.raw(model.theta[None])[0]
  problem = problem.reweighted(weighting_from(problem.observations, raw, floor))
  return problem, dataclasses.replace(model, residual=problem.residual(model.theta[None])[0])


def write_formula(shipped: Shipped | None, folder: Path, dataset: str, command_shift: int = 0) -> list[Path]:
  """Write the mechanism file and the twin with it; returns their paths, none where nothing is kept.

  A twin with a formula that an earlier diagnosis left in the folder goes: it is none of this data set. A mechanism file
  stays, which somebody may have changed.
  """
  (folder / TWIN).unlink(missing_ok=True)
  if shipped is None or not shipped.kept or shipped.rest.twin is None:
    return []
  twin, name = shipped.rest.twin, shipped.rest.twin.mechanism.name
  note = f"repaired on {dataset}, with {name}, which has no name"
  alike = alike_words(shipped.rest)
  return [
    write_mechanism(folder / f"{name}.py", twin.mechanism, twin.values, dataset, alike),
    save_twin(folder / TWIN, twin.problem.twin, twin.theta, note, command_shift),
  ]
