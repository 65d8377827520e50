"""The reduced car against MuJoCo's: cost, signals, slopes and what mechanisms do, on a data set's own driving.

Everything is in units of that data set's sensor noise, since what is below it no fit can see.
"""

import dataclasses
import time
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from calibration.concealed.benchmarks.speed import Pair, paired
from calibration.fitting.noise import noise_models
from calibration.fitting.noise_floor import sensor_floor
from calibration.fitting.observations import CHANNELS, observe
from calibration.fitting.windows import Cut
from calibration.progress import Progress, silent
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.timers import timers_stopped
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
_STEP = 0.02  # of a parameter's scale, for slopes
_VISIBLE = 1.0  # nats that a whole scale, or a typical size, must be worth to be seen at all


@dataclasses.dataclass(frozen=True)
class Agreement:
  """What the two cars have in common.

  Attributes:
    speed: seconds per 10 ms of one car, one thread.
    channels: rms difference at nominal parameters / sensor noise, by channel: median of the recordings.
    worst: the recording with the largest, and how much that is, by channel.
    drawn: the median over random parameter vectors, (vectors,) by channel.
    slopes: cosine of the two slopes in units of noise, by parameter, of those that can be seen: over all values, and
      without the recordings that are the worst of a channel.
    effects: the same of what the typical size of a mechanism changes, by mechanism.
    seconds: of driving.
  """

  speed: Pair
  channels: dict[str, float]
  worst: dict[str, tuple[str, float]]
  drawn: dict[str, Array]
  slopes: dict[str, tuple[float, float]]
  effects: dict[str, tuple[float, float]]
  seconds: float

  @property
  def vectors(self) -> int:
    """How many random ones there were."""
    return len(next(iter(self.drawn.values())))


class _Sides:
  """Both cars on one data set's driving."""

  def __init__(self, dataset: DataSet, most: float):
    recordings = [r for r in dataset.recordings if r.role != "holdout"]
    self.vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
    self.mechanisms = [m for m in catalogue().values() if self.vehicle.drive in m.drives]
    self.exact = Twin(self.vehicle, self.mechanisms)
    self.reduced = self.exact.on("reduced")
    self.seen = observe(recordings, self.vehicle, Cut(most=most, evenly=True))
    floor = sensor_floor(noise_models(recordings))
    noise = np.array([floor.get(name, np.nan) for name in CHANNELS])[self.seen.channel]
    self._scale = np.where(np.isfinite(noise) & (noise > 0.0), 1.0 / noise, 0.0)

  def answers(self, thetas: Array) -> tuple[Array, Array]:
    """Of MuJoCo and the reduced car in units of sensor noise, (n, M) each; 0 where that is unknown."""
    segments = self.seen.stretches.segments
    exact, reduced = (self.seen.predict(t.rollout(thetas, segments)) for t in (self.exact, self.reduced))
    return exact * self._scale, reduced * self._scale

  def by_recording(self, wrong: Array) -> dict[str, dict[str, float]]:
    """Channel -> recording -> rms of a difference, (M,)."""
    seen, table = self.seen, {}
    for name in seen.present:
      rows = seen.select(name) & (self._scale > 0.0)
      errors = {seen.names[k]: wrong[rows & (seen.recording == k)] for k in np.unique(seen.recording[rows])}
      if errors:
        table[name] = {recording: float(np.sqrt(np.mean(w**2))) for recording, w in errors.items()}
    return table


def compare_plants(
  dataset: DataSet, vectors: int = 50, seed: int = 0, most: float = np.inf, progress: Progress = silent
) -> Agreement:
  """Drive both cars through a data set.

  Args:
    dataset: its recordings but for role "holdout".
    vectors: random parameter vectors; each parameter is drawn from its prior, an open one within a third of its scale.
    seed: of those draws.
    most: s of driving.
  """
  sides = _Sides(dataset, most)
  progress("speed")
  speed = _speed(sides.vehicle)
  differences = []
  drawn = _drawn(sides.exact, vectors, seed)
  for k in range(0, len(drawn), 8):
    exact, reduced = sides.answers(drawn[k : k + 8])
    differences += [sides.by_recording(d) for d in reduced - exact]
    progress("random parameters", min(k + 8, len(drawn)) / len(drawn))
  progress("slopes and effects")
  median = lambda table: {name: float(np.median(list(of.values()))) for name, of in table.items()}
  nominal, *others = differences
  worst = {name: max(of.items(), key=lambda kv: kv[1]) for name, of in nominal.items()}
  cosines = _cosines(sides, {recording for recording, _ in worst.values()})
  return Agreement(
    speed=speed,
    channels=median(nominal),
    worst=worst,
    drawn={name: np.array([median(table)[name] for table in others]) for name in nominal},
    slopes={n: c for n, c in cosines.items() if n in sides.exact.base},
    effects={n: c for n, c in cosines.items() if n not in sides.exact.base},
    seconds=float(sides.seen.stretches.segments.steps.sum()) * 0.01,
  )


def _drawn(twin: Twin, vectors: int, seed: int) -> Array:
  """The nominal vector and random ones, (vectors + 1, P)."""
  base, rng = twin.base, np.random.default_rng(seed)
  spread = np.where([p.std is None for p in base], base.scale / 3.0, base.std)
  thetas = np.tile(twin.parameters.nominal, (vectors + 1, 1))
  moved = base.nominal + spread * rng.standard_normal((vectors, len(base)))
  thetas[1:, : len(base)] = np.clip(moved, base.lower, base.upper)
  return thetas


def _cosines(sides: _Sides, apart: Collection[str]) -> dict[str, tuple[float, float]]:
  """Of the changes that both cars show for a parameter's step and for a mechanism's typical size, of those seen.

  Over all recordings, and without some.
  """
  twin, base = sides.exact, sides.exact.base
  moved = [twin.parameters.nominal]
  for i in range(len(base)):
    step = _STEP * base.scale[i]
    moved.append(moved[0].copy())
    moved[-1][i] += step if base.nominal[i] + step < base.upper[i] else -step
  for m in sides.mechanisms:
    moved.append(moved[0].copy())
    for p in m.parameters:
      if p.null is not None:
        moved[-1][twin.parameters.index(p.name)] = p.null + (p.typical or p.scale)
  exact, reduced = sides.answers(np.stack(moved))
  change, other = exact[1:] - exact[0], reduced[1:] - reduced[0]
  size = np.sqrt(np.sum(change**2, axis=1))
  rest = np.array([name not in apart for name in sides.seen.names])[sides.seen.recording]
  pairs = zip(_cosine(change, other), _cosine(change[:, rest], other[:, rest]), strict=True)
  whole = np.where(np.arange(len(size)) < len(base), size / _STEP, size)
  names = [*base.names, *(m.name for m in sides.mechanisms)]
  return {n: pair for n, pair, w in zip(names, pairs, whole, strict=True) if 0.5 * w**2 > _VISIBLE}


def _cosine(one: Array, other: Array) -> list[float]:
  """Of each row with the same row, (n,)."""
  power = np.sum(one**2, axis=1) * np.sum(other**2, axis=1)
  return (np.sum(one * other, axis=1) / np.sqrt(np.maximum(power, 1e-300))).tolist()


def _speed(vehicle: Vehicle, cars: int = 256, periods: int = 20, rounds: int = 15) -> Pair:
  """10 ms of a car that drives and steers, by the processor's time of one thread."""
  sides = []
  for engine in ("mujoco", "reduced"):
    twin = Twin(vehicle, threads=1, engine=engine)
    sides.append(twin.begin(np.tile(twin.parameters.nominal, (cars, 1)), np.zeros((cars, 7))))
  commands = np.tile([1.5, 0.15], (cars, 1))
  drive = lambda simulation: [simulation.step(commands) for _ in range(periods)]
  with timers_stopped():
    for side in sides:
      drive(side)
    first, second, ratio = paired(lambda: drive(sides[0]), lambda: drive(sides[1]), rounds, time.process_time)
  each = (first / periods / cars, second / periods / cars)
  return Pair(f"10 ms, {cars} cars side by side", ("MuJoCo", "reduced car"), each, "car", ratio, 25.0, at_most=False)
