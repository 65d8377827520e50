"""Fair tuning: every controller is searched on one path with the same noise, servo, mismatch and cap on its rate."""

import dataclasses
import logging
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from agents.control.closed_loop import Actuation, Scenario, drive
from agents.control.controllers import Family, make, side_by_side
from agents.control.kpis import kpis
from agents.control.speed import SpeedGains
from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.observer import SensedObserver
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.plant import Plant
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors
from qcar_twin.tracks import path_from

Array = NDArray[np.float64]
log = logging.getLogger(__name__)
MISMATCH = ((1.0, 0.0), (0.95, 0.5), (1.05, -0.5), (1.0, 0.0))  # steering gain -, offset deg, of the cars of a trial


def spread_linkages(gain: float, offset: float, count: int, seed: int = 0) -> tuple[tuple[float, float], ...]:
  """Steering gains, -, and offsets, deg, drawn uniformly within 1 +- gain and +- offset."""
  drawn = np.random.default_rng([seed, 4]).uniform(-1.0, 1.0, (count, 2)) * (gain, offset)
  return tuple((1.0 + float(a), float(b)) for a, b in drawn)


@dataclasses.dataclass(frozen=True)
class Search:
  """A cross-entropy search over the logarithms of a controller's numbers.

  Attributes:
    candidates: per generation.  elite: of them kept.  generations: how many.
    rate_cap: root mean square steering rate allowed, rad/s.
    speed: m/s.  seed: of sensors and search.
    path: that is driven.  mismatch: steering gain, -, and offset, deg, of the cars of a trial.
    servo: delay and lag, s, of the steering command on its way to a plant that has no servo of its own; else zeros.
  """

  candidates: int = 24
  elite: int = 6
  generations: int = 8
  rate_cap: float = float(np.radians(80.0))
  speed: float = 0.5
  seed: int = 0
  path: str = "s"
  mismatch: tuple[tuple[float, float], ...] = MISMATCH
  servo: tuple[float, float] = (Actuation.delay, Actuation.lag)


def origin_of(search: Search, plant: str, numbers: Mapping[str, float], unknown: Sequence[str] = ()) -> str:
  """Where tuned numbers come from, in a line.

  Args:
    plant: its name.  numbers: its parameters.  unknown: numbers that the filter estimates besides.
  """
  said = ", ".join(f"{name} {value:.4g}" for name, value in numbers.items())
  delay, lag = search.servo
  driven = {
    "bicycle": f"the single track ({said}), servo lag {1e3 * lag:.0f} ms and delay {1e3 * delay:.0f} ms",
    "mujoco": "the nominal twin",
    "reduced": "the nominal twin on the reduced car",
  }[plant]
  path = {"s": "S-path"}.get(search.path, f"path {search.path}")
  (least, most), (right, left) = ((min(column), max(column)) for column in zip(*search.mismatch, strict=True))
  besides = f" estimating {', '.join(unknown)}" if unknown else ""
  return (
    f"qcar-twin tune: {path} at {search.speed:g} m/s on {driven}, sensors and federated filter{besides},"
    f" {len(search.mismatch)} cars of steering gain {least:.3g} to {most:.3g} and offset {right:+.2g} to {left:+.2g}"
    f" deg, cap {np.degrees(search.rate_cap):.0f} deg/s rms, {search.generations} x {search.candidates} trials,"
    f" seed {search.seed}"
  )


@dataclasses.dataclass(frozen=True)
class Tuned:
  """What a search found: numbers by name, their RMSE in m and steering rate in rad/s over the trial."""

  numbers: dict[str, float]
  rmse: float
  steering_rate: float


def tune(
  family: Family,
  plant: Plant,
  theta: Array,
  car: SingleTrackCar,
  settings: FilterSettings,
  search: Search,
  progress: Callable[[str, float], None] | None = None,
) -> Tuned:
  """Least RMSE on the search's path under the rate cap.

  Args:
    family: the controller's numbers and where to begin.
    plant, theta: what is driven, and its parameters (P,).
    car: the identified model that gains, speed control and filter use.
    settings: of the filter.
    progress: called with the controller and the share of its generations that is done.
  """
  rng = np.random.default_rng(search.seed)
  mean, spread = np.log10(family.start), np.full(len(family.start), family.spread)
  for generation in range(search.generations):
    points = mean + spread * rng.standard_normal((search.candidates, len(mean)))
    points[0] = mean
    seed = search.seed + 1 + generation  # new noise each time: no candidate wins by luck for long
    costs, _ = _trial(family, points, plant, theta, car, settings, search, seed)
    order = np.argsort(costs)[: search.elite]
    mean, spread = points[order].mean(axis=0), np.maximum(points[order].std(axis=0), 0.02)
    log.info("%s generation %d: %.2f mm", family.name, generation, 1e3 * costs[order[0]])
    if progress:
      progress(family.name, (generation + 1) / search.generations)
  _, trials = _trial(family, mean[None], plant, theta, car, settings, search, search.seed + 1000)
  return trials[0]


def _trial(
  family: Family,
  points: Array,
  plant: Plant,
  theta: Array,
  car: SingleTrackCar,
  settings: FilterSettings,
  search: Search,
  seed: int,
) -> tuple[Array, list[Tuned]]:
  """Costs (m) of candidates (C, k) as logarithms, each driven once per mismatch."""
  cars = len(search.mismatch)
  numbers = [dict(zip(family.numbers, (10.0**point).tolist(), strict=True)) for point in points]
  controller = side_by_side([make(family.name, entry, car, search.speed) for entry in numbers], cars)
  count = cars * len(points)
  gain, offset = np.tile(np.array(search.mismatch).T, len(points))
  actuation = Actuation(*search.servo, gain=gain, offset=np.radians(offset))
  scenario = Scenario(path_from(search.path), speed=search.speed, actuation=actuation)
  observer = SensedObserver(SensorSuite(qcar_sensors(), count, seed), car, settings)
  result = kpis(drive(plant, np.tile(theta, (count, 1)), controller, SpeedGains.design(car), observer, scenario))
  rmse = np.sqrt(np.mean(np.where(result.finished, result.rmse, 1.0).reshape(-1, cars) ** 2, axis=1))
  rate = np.sqrt(np.mean(result.steering_rate.reshape(-1, cars) ** 2, axis=1))
  costs = rmse + 0.1 * np.maximum(rate / search.rate_cap - 1.0, 0.0)
  return costs, [Tuned(*row) for row in zip(numbers, rmse.tolist(), rate.tolist(), strict=True)]
