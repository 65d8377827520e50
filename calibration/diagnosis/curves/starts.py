"""What of a free twin's errors is the search's: the same fit from several starts.

The first start is where the fit begins anyway. The others are drawn about it, every parameter by its own scale (what
was measured of it, or its typical size) and within its bounds, and are fitted to the same residuals with the same
weights. Where all end in one minimum their costs and errors agree.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

from calibration.diagnosis.curves.driven import error_of
from calibration.diagnosis.curves.finish import finished
from calibration.diagnosis.curves.flexible import Characterised, characterise
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.fitting.observations import UNITS
from calibration.fitting.recalibration import settled_from
from calibration.log_check.ready import ready
from calibration.progress import Progress, silent
from qcar_twin.recordings.dataset import DataSet


@dataclasses.dataclass(frozen=True)
class Started:
  """Where one start ended.

  Attributes:
    began: half the sum of squares where the fit began, priors included, nats.
    cost: the same at the minimum.
    errors: root mean square errors by channel where nothing was fitted: the hold-out, or what only judged; {} without
      either.
  """

  began: float
  cost: float
  errors: Mapping[str, float]


def from_starts(
  dataset: DataSet, count: int, seed: int = 0, most: float = LONGEST, threads: int = 0, progress: Progress = silent
) -> tuple[Started, ...]:
  """The twin with free maps from the usual start and from `count` - 1 drawn ones.

  Args:
    dataset: as `study` takes it.
    count: starts.
    seed: of the drawn ones.
    most: s of driving that are simulated, spread evenly.
    threads: of the simulation, 0 for all cores.
    progress: reports which start.

  Raises:
    ValueError: fewer than two starts, of which no spread can be told.
  """
  if count < 2:
    raise ValueError(f"--starts {count}: a spread takes two starts at least")
  dataset, _ = ready(dataset, most, evenly=True)
  progress(f"start 1 of {count}")
  first = characterise(dataset, most=most, threads=threads)
  made, random = [_ended(first, dataset, first.fitted.fit.iterations[0])], np.random.default_rng(seed)
  for k in range(1, count):
    progress(f"start {k + 1} of {count}")
    again, began = _again(first, random)
    made.append(_ended(again, dataset, began))
  return tuple(made)


def _again(first: Characterised, random: np.random.Generator) -> tuple[Characterised, float]:
  """The same fit from a start that is drawn, and the cost there."""
  old = first.fitted
  free = old.fit.parameters
  start = np.clip(free.nominal + free.scale * random.standard_normal(len(free)), free.lower, free.upper)
  found = settled_from(old, start)
  return dataclasses.replace(first, fitted=found), found.fit.iterations[0]


def _ended(found: Characterised, dataset: DataSet, began: float) -> Started:
  aside = dataset.role("holdout")
  twin = finished(found) if aside else found
  judging = aside or dataset.role("validate")
  return Started(float(began), float(found.fitted.fit.cost), error_of(twin.fitted, judging) if judging else {})


def sentences(found: tuple[Started, ...]) -> list[str]:
  """What the terminal says, a line a channel: every start's error, the usual one first, and their deviation."""
  listed = lambda values: ", ".join(f"{v:.4g}" for v in values)
  lines = [f"cost [nats]: {listed(s.cost for s in found)}, from {listed(s.began for s in found)}"]
  for name in found[0].errors:
    errors = [s.errors[name] for s in found]
    spread = float(np.std(errors, ddof=1))
    lines.append(f"{name} [{UNITS[name]}]: {listed(errors)}; standard deviation {spread:.2g}")
  return lines
