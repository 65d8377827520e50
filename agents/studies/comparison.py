"""Drivers against each other on the same plant with the same filter and the same noise, paired stream by stream.

Car k of every driver has the same sensor noise and linkage. Differences of RMSE are taken pair by pair; on the random
tracks, whose streams share a track, a track's mean difference is one observation.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from agents.control import controllers
from agents.control.interface import Controller
from agents.control.model import Model
from agents.learning.evaluate import EvaluationCase, described, digest, run_together
from agents.learning.sb3_zip import any_policy
from qcar_twin.atomic_io import write_json
from qcar_twin.untrusted import read_json

Array = NDArray[np.float64]
PATHS = ("o", "infinity", "c")
MISMATCHES = {"N": (1.0, 0.0), "MIS": (0.92, 1.0)}  # steering gain -, offset deg
FIRST_TRACK, FIRST_SEED = 1000, 7000  # of random tracks and sensors; no training, tuning or choice has seen them
PLAIN = ", plain filter"
LEFT = 0.5  # m, counted for a run that left its path: the error at which it is over


@dataclasses.dataclass(frozen=True)
class Design:
  """What is driven.

  Attributes:
    plant: its name.  speed: m/s.
    streams: of noise on each of PATHS.  tracks: random ones.  per_track: streams on each.
    unknown: numbers that the filter estimates besides.
    plain_too: everybody drives a second time, with the plain filter.
    after: s from each start that do not count.
  """

  plant: str = "reduced"
  speed: float = 0.5
  streams: int = 100
  tracks: int = 20
  per_track: int = 5
  unknown: tuple[str, ...] = ()
  plain_too: bool = False
  after: float = 0.0

  @property
  def filters(self) -> dict[str, tuple[str, ...]]:
    """What each filter estimates besides, by what is added to a driver's name."""
    return {"": self.unknown} | ({PLAIN: ()} if self.plain_too else {})

  def cases(self, mismatch: str, unknown: tuple[str, ...] = ()) -> dict[str, list[EvaluationCase]]:
    """Cases of each course, by its name, with a filter that estimates `unknown` besides."""
    gain, offset = MISMATCHES[mismatch]
    made = lambda path, cars, seed: EvaluationCase(
      path, self.plant, self.speed, gain, offset, cars, seed, unknown=unknown, after=self.after
    )
    courses = {path: [made(path, self.streams, FIRST_SEED)] for path in PATHS}
    if self.tracks:
      random = [made(f"random:{FIRST_TRACK + k}", self.per_track, FIRST_SEED + 1 + k) for k in range(self.tracks)]
      courses["random tracks"] = random
    return courses


@dataclasses.dataclass(frozen=True)
class Difference:
  """Of two drivers' RMSE, m: mean, half-width of its 95 % interval, and how many observations it rests on."""

  mean: float
  half_width: float
  count: int

  @property
  def verdict(self) -> str:
    """Which of the two errs less, if that is known."""
    return "less" if self.mean + self.half_width < 0.0 else "more" if self.mean - self.half_width > 0.0 else "open"


def paired(one: Array, other: Array) -> Difference:
  """Of RMSEs (tracks, streams), m; a single track's streams are the observations, else the tracks' means.

  Mean +- t(0.975, n - 1) s / sqrt(n) (Student, The probable error of a mean, Biometrika 6, 1908).
  """
  difference = one - other
  observed = difference[0] if len(difference) == 1 else difference.mean(axis=1)
  count = len(observed)
  half = float(stats.t.ppf(0.975, count - 1) * np.std(observed, ddof=1) / np.sqrt(count)) if count > 1 else np.inf
  return Difference(float(np.mean(observed)), half, count)


def drivers_of(
  policies: Sequence[Path], files: Sequence[Path], wanted: Sequence[str], speed: float
) -> dict[str, Controller]:
  """Policies by kind, numbered where several are of one, and tuned controllers of TOML files by name and file."""
  car, drivers = Model.nominal().car, {}
  for place in policies:
    policy = any_policy(place)
    alike = sum(label.split(" #")[0] == policy.name for label in drivers)
    drivers[f"{policy.name} #{alike + 1}" if alike else policy.name] = policy
  for file in files:
    table = controllers.load(car, speed, file)
    drivers |= {f"{name} ({file.stem})": table[name, "tuned"] for name in wanted if (name, "tuned") in table}
  return drivers


def compare(
  drivers: Mapping[str, Controller],
  design: Design,
  said: Callable[[str], None] = lambda text: None,
  kept: "Kept | None" = None,
) -> dict[str, dict[str, dict[str, Array]]]:
  """RMSE, m, of every driver: by mismatch, course and driver, (tracks, streams).

  Args:
    said: is given a line for every course.
    kept: what was driven before; it is not driven again.
  """
  driven: dict[str, dict[str, dict[str, Array]]] = {mismatch: {} for mismatch in MISMATCHES}
  for mismatch, (suffix, unknown) in itertools.product(MISMATCHES, design.filters.items()):
    for course, cases in design.cases(mismatch, unknown).items():
      name = f"{mismatch} {course}{suffix}"
      rmse = (kept.get(name) if kept else None) or _driven(drivers, cases)
      if kept:
        kept.keep(name, rmse)
      values = {label + suffix: np.array(numbers) for label, numbers in rmse.items()}
      driven[mismatch].setdefault(course, {}).update(values)
      said(f"{mismatch} {course}: " + ", ".join(f"{k} {1e3 * v.mean():.2f} mm" for k, v in values.items()))
  return driven


def _driven(drivers: Mapping[str, Controller], cases: Sequence[EvaluationCase]) -> dict[str, Any]:
  """RMSE of every driver, m, (tracks, streams) as lists."""
  rows = [run_together(drivers, case) for case in cases]
  rmse = lambda row: np.where(np.isfinite(row.kpis.rmse), row.kpis.rmse, LEFT).tolist()
  return {label: [rmse(row[i]) for row in rows] for i, label in enumerate(drivers)}


def identities(policies: Sequence[Path], files: Sequence[Path]) -> list[str]:
  """SHA-256 of the weights of policies and of files of controllers."""
  return [*(described(place)["sha256"] for place in policies), *(digest(file) for file in files)]


class Kept:
  """Courses or circumstances that were driven, in a file; those of another design or other drivers are forgotten.

  Args:
    file: JSON.  about: whatever must be the same, as JSON has it.
  """

  def __init__(self, file: Path, about: Any):
    self._file, before = file, read_json(file) if file.is_file() else {}
    self._content = before if before.get("about") == about else {"about": about, "courses": {}}

  def get(self, name: str) -> dict[str, Any] | None:
    """A course's values; None where it was not driven."""
    return self._content["courses"].get(name)

  def keep(self, name: str, rmse: Mapping[str, Any]) -> None:
    """Add a course's values."""
    self._content["courses"][name] = rmse
    write_json(self._file, self._content)


def as_json(driven: Mapping[str, Any], first: str, design: Design, policies: Sequence[Path]) -> dict[str, Any]:
  """What a reader needs to check the table: values, differences of `first` from everybody, what the policies are."""
  differences = {
    mismatch: {
      course: {label: dataclasses.asdict(paired(values[first], v)) for label, v in values.items() if label != first}
      for course, values in courses.items()
    }
    for mismatch, courses in driven.items()
  }
  values = {m: {c: {k: v.tolist() for k, v in vs.items()} for c, vs in cs.items()} for m, cs in driven.items()}
  about = [described(place) for place in policies]
  return {"design": dataclasses.asdict(design), "policies": about, "differences": differences, "rmse": values}


def in_markdown(driven: Mapping[str, Any], first: str) -> str:
  """Two tables: mean RMSE in mm, and differences of `first` from everybody with their 95 % intervals."""
  columns = [(m, c) for m, courses in driven.items() for c in courses]
  drivers = list(next(iter(next(iter(driven.values())).values())))
  head = "| | " + " | ".join(f"{c} {m}" for m, c in columns) + " |\n" + "|---" * (len(columns) + 1) + "|\n"
  mean = lambda label, m, c: f"{1e3 * driven[m][c][label].mean():.2f}"
  rows = [f"| {label} | " + " | ".join(mean(label, m, c) for m, c in columns) + " |" for label in drivers]
  against = []
  for label in drivers:
    if label == first:
      continue
    cells = [paired(driven[m][c][first], driven[m][c][label]) for m, c in columns]
    said = " | ".join(f"{1e3 * d.mean:+.2f} ± {1e3 * d.half_width:.2f}" for d in cells)
    against.append(f"| {label} | {said} |")
  means = "Mean RMSE of the cross-track error, mm:\n\n" + head + "\n".join(rows)
  about = (
    f"RMSE of `{first}` less that of each other driver, mm, with 95 % intervals (below zero: `{first}` errs less):"
  )
  return f"{means}\n\n{about}\n\n{head}" + "\n".join(against) + "\n"
