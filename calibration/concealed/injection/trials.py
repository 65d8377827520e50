"""Trials on a real data set, by the user's own comparison of two data sets (`qcar-twin curves --compare`).

An injection compares the set with itself after something was put in; a split compares two halves that differ in
nothing. Sizes are drawn by what they show: with s the stated deviation of what an injection moves, and o that of its
prior, an estimate follows a change d by c d, c = 1 - s^2 / o^2, the share of it that the recordings and not the prior
say. The difference of two sets has sqrt(2) s, so that d is worth (c d)^2 / (2 (2 s^2)) nats.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration.diagnosis.curves.comparison import Moved, differing, estimates, units
from calibration.diagnosis.curves.flexible import Characterised, characterise, reaches
from calibration.log_check.ready import ready
from qcar_twin.atomic_io import write_json
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.untrusted import read_json
from qcar_twin.vehicle.vehicle import Vehicle

from ..laboratory.written import stream
from .halves import halves
from .into import Injection, fitting, injected

LEAST, MOST = 5.0, 500.0  # nats, log-uniform
Estimates = dict[str, tuple[float, float]]


@dataclasses.dataclass(frozen=True)
class Fitted:
  """What is kept of a fit, by number.

  Attributes:
    estimates: with their deviations.  units: of them.
    shares: c, how far each follows the car; 1 without a prior, 0 where nothing but the prior tells it.
  """

  estimates: Estimates
  units: dict[str, str]
  shares: dict[str, float]

  @classmethod
  def of(cls, car: Characterised) -> Fitted:
    """Of a characterised twin."""
    told, fit = estimates(car), car.fitted.fit
    prior = dict(zip(fit.parameters.names, (1.0 / fit.parameters.deviation_slopes(fit.theta)).tolist(), strict=True))
    return cls(told, units(car), {name: own_share(std, prior[name]) for name, (_, std) in told.items()})


@dataclasses.dataclass(frozen=True)
class Bench:
  """One data set and where its trials are kept.

  Attributes:
    most: s of driving that each fit simulates.  seed: of sizes and halves.
  """

  dataset: DataSet
  folder: Path
  most: float
  seed: int

  def fitted(self, name: str, dataset: DataSet) -> Fitted:
    """Of a data set's characterised twin; kept, so that a fit is made once.

    Raises RecordingError where the check of the log refuses it.
    """
    path = self.folder / "fits" / f"{name}.json"
    if not path.is_file() or "shares" not in read_json(path):
      vehicle = Vehicle.from_dataset(self.dataset.vehicle, self.dataset.vehicle_std)
      reach = reaches([r for r in self.dataset.recordings if r.role != "holdout"], vehicle)
      car = characterise(ready(dataset)[0], most=self.most, threads=1, reach=reach)
      write_json(path, dataclasses.asdict(Fitted.of(car)))
    there = read_json(path)
    return Fitted({n: (value, std) for n, (value, std) in there["estimates"].items()}, there["units"], there["shares"])

  def injection(self, number: int) -> dict[str, Any]:
    """The trial of this number: kinds in turn, sizes drawn."""
    kinds = fitting(self.dataset)
    name = list(kinds)[number % len(kinds)]
    plain = self.fitted("untouched", self.dataset)
    rng = stream(self.seed, 1000 + number)
    size, nats = drawn(kinds[name], plain, rng)
    trial: dict[str, Any] = {"trial": f"injection_{number:03d}", "effect": name, "size": size, "nats": nats,
                             "unit": kinds[name].unit}  # fmt: skip
    try:
      other = self.fitted(trial["trial"], injected(self.dataset, kinds[name], size))
    except RecordingError as error:
      return trial | {"refused": str(error), "moved": []}
    moved = differing(plain.estimates, other.estimates, plain.units)
    back, std = came_back(kinds[name], plain, other)
    return trial | _told(moved) | {"back": back, "back_std": std, "right": sorted(kinds[name].right)}

  def split(self, number: int) -> dict[str, Any]:
    """Two halves of the set; whatever moved is false."""
    first, second = halves(self.dataset, stream(self.seed, 2000 + number))
    trial: dict[str, Any] = {"trial": f"split_{number:03d}"}
    try:
      one, other = (
        self.fitted(f"{trial['trial']}_{which}", half) for which, half in (("first", first), ("second", second))
      )
    except RecordingError as error:
      return trial | {"refused": str(error), "moved": []}
    return trial | _told(differing(one.estimates, other.estimates, one.units))


def own_share(std: float, prior: float) -> float:
  """How far an estimate with this deviation follows the car, c = 1 - s^2 / o^2; none follows it the other way."""
  return max(0.0, 1.0 - (std / prior) ** 2)


def drawn(injection: Injection, plain: Fitted, rng: np.random.Generator) -> tuple[float, float | None]:
  """A size, and the nats that it is worth; None where no number of the twin is its own, or none that follows it.

  Then, and where the nats that were drawn need more than the largest size, sizes are log-uniform over two decades.
  """
  sign = float(rng.choice([-1.0, 1.0])) if injection.signed else 1.0
  nats, share = float(np.exp(rng.uniform(np.log(LEAST), np.log(MOST)))), float(10.0 ** rng.uniform(-2.0, 0.0))
  spread = _spread(injection, plain)
  if spread is None:
    return sign * share * injection.most, None
  size = 2.0 * spread * np.sqrt(nats)
  if size > injection.most:
    size = max(share, 0.1) * injection.most
  return sign * float(size), float((size / (2.0 * spread)) ** 2)


def came_back(injection: Injection, one: Fitted, other: Fitted) -> tuple[float | None, float | None]:
  """The size that the difference of two fits shows, and its deviation: least squares over what it moves."""
  names = [n for n in injection.shows if n in other.estimates and one.shares.get(n, 0.0) > 0.0]
  if not names:
    return None, None
  slope = np.array([one.shares[name] * injection.shows[name] for name in names])
  (first, std), (second, std_too) = (np.array([fit.estimates[name] for name in names]).T for fit in (one, other))
  weight, moved = 1.0 / (std**2 + std_too**2), second - first
  power = float(weight @ slope**2)
  return float(weight @ (slope * moved)) / power, power**-0.5


def _spread(injection: Injection, plain: Fitted) -> float | None:
  """Stated deviation of its size, over how far the numbers follow it."""
  there = [name for name in injection.shows if name in plain.estimates]
  power = sum((plain.shares[name] * injection.shows[name] / plain.estimates[name][1]) ** 2 for name in there)
  return power**-0.5 if power > 0.0 else None


def _told(moved: tuple[Moved, ...]) -> dict[str, Any]:
  return {"moved": [dataclasses.asdict(m) for m in moved if m.there], "numbers": len(moved)}


def kept(folder: Path) -> list[Mapping[str, Any]]:
  """Trials that were made, in order."""
  path = folder / "trials.ndjson"
  return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []
