"""The section of the results on the filter under faults: errors, honesty, recovery and consistency, with and without
its watches."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, binomtest, chi2

from agents.control.interface import Controller
from agents.control.model import Model
from agents.studies.fault_study import BEGIN, END, FAULTS, PATHS, SECONDS, WARM_UP, Run, estimate, record
from qcar_twin import markdown
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.sensors.faults import Fault

Array = NDArray[np.float64]
Runs = Callable[[tuple[Fault, ...], bool], Run]
PLANT = "mujoco"
PERIOD = 0.01  # s
AFTER = 2.0  # s after the end of a fault, where consistency is looked at again
CONFIDENCE = 0.95


def fault_section(model: Model, controller: Controller, count: int, quick: bool = False) -> list[str]:
  """Every class of faults on every path, the filter with its watches and without; two classes when `quick`."""
  paths, classes = (PATHS[:1], ("none", "encoder stuck")) if quick else (PATHS, tuple(FAULTS))
  drives = [record(model, PLANT, controller, path, count, 100 + i) for i, path in enumerate(paths)]
  runs = lambda faults, watched: joined([estimate(model, PLANT, d, faults, watched) for d in drives])
  sound = {watched: runs((), watched) for watched in (False, True)}
  typical = float(np.sqrt(np.mean(sound[True].error[row(WARM_UP) :] ** 2)))
  errors, honesty = [], []
  for name in classes:
    case = FAULTS[name]
    for watched in (False, True):
      title = name if not watched else "- with the watches"
      pairs = [
        _variant(runs, sound, variant, i, len(case.variants), watched) for i, variant in enumerate(case.variants)
      ]
      faulty, reference = joined([a for a, _ in pairs]), joined([b for _, b in pairs])
      errors.append((title, *_error_cells(faulty, reference, case.end, typical)))
      honesty.append((title, *_honesty_cells(faulty)))
  number = sound[True].error.shape[1]
  about = [f"* {name}: {case.about}" for name, case in FAULTS.items() if name in classes]
  return [
    "## The filter under faults",
    "",
    f"Paths {', '.join(paths)}, {count} cars each on the twin, {number} runs of {SECONDS:.0f} s at 0.3 to 0.7 m/s;"
    f" a fault begins at {BEGIN:.0f} s. The car is steered on the estimate of sound sensors; the faulty readings are"
    " made from the same true motion with the same noise. The first row of each class is the filter without its"
    f" watches, which trains the agents. Intervals are exact ({100 * CONFIDENCE:.0f} %): of medians by order"
    " statistics, of shares Clopper and Pearson's.",
    "",
    *about,
    "",
    *_errors_part(errors, typical),
    "",
    *_honesty_part(honesty, number),
  ]


def _errors_part(rows: list[tuple[str, ...]], typical: float) -> list[str]:
  return [
    "Position error from the fault's begin on. Recovery is how long after its end the estimate is last more than"
    f" {1e3 * typical:.1f} mm off, the RMSE with sound sensors. Off is the distance from what the sound sensors of the"
    " same run give. For a bias that stays, recovery counts from its begin.",
    "",
    *markdown.table(
      ("fault", "peak, median [mm]", "peak, largest", "yaw peak [mrad]", "recovery [s]", "longest"), rows
    ),
  ]


def _honesty_part(rows: list[tuple[str, ...]], number: int) -> list[str]:
  low, high = chi2.ppf([0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2], 2 * number) / number
  return [
    f"Honesty: the bounds that are stated with the estimate are exceeded with probability {FilterSettings().risk:g}"
    " each. Valid is the share of all instants from the fault's begin on; beyond is the share of the valid instants"
    " at which position or yaw are beyond their bounds. Then come the runs in which that happens at all, of all, with"
    f" the interval of the share in per cent. NEES of the position at the fault's end and {AFTER:g} s later, mean over"
    f" the runs; a consistent filter's lies in [{low:.1f}, {high:.1f}], below is caution.",
    "",
    *markdown.table(
      (
        "fault",
        "valid",
        "position beyond",
        "runs",
        "yaw beyond",
        "runs",
        "position bound, median [mm]",
        "NEES at the end",
        "later",
      ),
      rows,
    ),
  ]


def row(time: float) -> int:
  """Of a `Run` at a time, s."""
  return round(time / PERIOD) - 1


def joined(parts: Sequence[Run]) -> Run:
  """All cars of several runs of one length."""
  columns = zip(*([getattr(part, name) for name in Run.__dataclass_fields__] for part in parts), strict=True)
  return Run(*(np.concatenate(column, axis=1) for column in columns))


def _variant(
  runs: Runs, sound: dict[bool, Run], faults: tuple[Fault, ...], which: int, of: int, watched: bool
) -> tuple[Run, Run]:
  """The runs that one variant of a class gets, and the sound ones that go with them."""
  share = slice(which, None, of)
  pick = lambda run: Run(*(getattr(run, name)[:, share] for name in Run.__dataclass_fields__))
  return pick(runs(faults, watched) if faults else sound[watched]), pick(sound[watched])


def _error_cells(faulty: Run, sound: Run, end: float, typical: float) -> tuple[str, ...]:
  peak = 1e3 * faulty.error[row(BEGIN) :].max(axis=0)
  turned = 1e3 * np.abs(faulty.yaw[row(BEGIN) :]).max(axis=0)
  away = np.hypot(*np.moveaxis(faulty.position - sound.position, -1, 0))[row(end) :] > typical
  recovery = np.where(away.any(axis=0), len(away) - np.argmax(away[::-1], axis=0), 0) * PERIOD
  longest = f"{recovery.max():.1f}" if not away[-1].any() else f"{away[-1].sum()} never"
  return middle(peak, 0), f"{peak.max():.0f}", middle(turned, 0), middle(recovery, 1), longest


def _honesty_cells(faulty: Run) -> tuple[str, ...]:
  late = slice(row(BEGIN), None)
  valid, beyond = faulty.valid[late], faulty.beyond[late]
  cells = [f"{100 * valid.mean():.1f} %"]
  for i in range(2):
    wrong = beyond[..., i] & valid
    cells += [f"{100 * wrong.sum() / max(valid.sum(), 1):.1f} %", share(np.asarray(wrong.any(axis=0)))]
  cells.append(f"{1e3 * np.median(faulty.bounds[late, :, 0]):.0f}")
  return *cells, *(f"{faulty.nees[row(t)].mean():.1f}" for t in (END, END + AFTER))


def middle(values: Array, digits: int) -> str:
  """Median and its exact interval by order statistics."""
  ordered, n = np.sort(values), len(values)
  below = max(int(binom.ppf(0.5 - CONFIDENCE / 2, n, 0.5)) - 1, 0)
  return f"{np.median(values):.{digits}f} [{ordered[below]:.{digits}f}, {ordered[n - 1 - below]:.{digits}f}]"


def share(which: NDArray[np.bool_]) -> str:
  """How many of how many, and the exact interval of the share, per cent."""
  interval = binomtest(int(which.sum()), len(which)).proportion_ci(CONFIDENCE, "exact")
  return f"{which.sum()} of {len(which)} [{100 * interval.low:.0f}, {100 * interval.high:.0f}]"
