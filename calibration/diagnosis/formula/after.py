"""A formula as a stage of a diagnosis: only where something stays unexplained, and never in the way of the verdict."""

import copy
import dataclasses
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration.diagnosis.candidates import refine
from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.formula.finding import Found, find_formula
from calibration.diagnosis.formula.words import alike_words
from calibration.diagnosis.holdout_errors import ChannelFit, compare_twins, ratio
from calibration.diagnosis.pool import Pool
from calibration.fitting.windows import Cut
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.formula.written import write_mechanism

log = logging.getLogger(__name__)

_SETTLE = 2  # Gauss-Newton steps with fresh columns: the model's end, and slopes that belong to it
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
    fits = self.holdout
    return ratio({n: f.after for n, f in fits.items()}, {n: f.before for n, f in fits.items()})


def formula_left(pool: Pool, decision: Decision, recordings: Sequence[Recording], cut: Cut) -> Shipped | None:
  """The formula of what the model behind the claims leaves unexplained; None where nothing is.

  Args:
    pool: all fitted models.
    decision: with its verdict.
    recordings: held-out ones, for the errors.
    cut: how they are cut.
  """
  if decision.verdict not in ("unexplained", "partly_explained"):
    return None
  winner = copy.copy(pool.model(decision.mechanisms))
  winner.settled, winner.jacobian = False, winner.jacobian.copy()
  problem = pool.problem.at(winner.theta)
  refine(problem, [winner], _SETTLE, full=True)
  try:
    found = find_formula(problem, winner, pool.priors)
  except np.linalg.LinAlgError as error:  # the verdict stands without it
    log.warning("no formula was sought: %s", error)
    return None
  if not (found.kind and found.twin):
    return Shipped(found, {})
  twin, parameters = found.twin.problem.twin, found.twin.problem.parameters
  before = parameters.nominal
  before[[parameters.index(p.name) for p in pool.problem.parameters]] = winner.theta
  fits, _ = compare_twins(twin, before, found.twin.theta, recordings, pool.floor, cut)
  return Shipped(found, fits)


def write_formula(shipped: Shipped | None, folder: Path, dataset: str) -> list[Path]:
  """Write the mechanism file and the twin with it; returns their paths, none where nothing is kept."""
  if shipped is None or not shipped.kept or shipped.rest.twin is None:
    return []
  twin, name = shipped.rest.twin, shipped.rest.twin.mechanism.name
  note = f"repaired on {dataset}, with {name}, which has no name"
  alike = alike_words(shipped.rest)
  return [
    write_mechanism(folder / f"{name}.py", twin.mechanism, twin.values, dataset, alike),
    save_twin(folder / TWIN, twin.problem.twin, twin.theta, note),
  ]
