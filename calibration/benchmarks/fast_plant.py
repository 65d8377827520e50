"""The reduced car beside MuJoCo's: cost, signals, slopes and what mechanisms do, on a data set's own driving.

Everything is in units of that data set's sensor noise, since what is below it no fit can see.
"""

import dataclasses
import time

import numpy as np
from numpy.typing import NDArray

from calibration.benchmarks.speed import Pair, paired
from calibration.fitting.noise import noise_passport
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
    channels: rms difference at nominal parameters / sensor noise, by channel.
    drawn: the same over random parameter vectors, (vectors,) by channel.
    worst: recording of the largest difference at nominal parameters, by channel.
    slopes: cosine of the two slopes of all values in units of noise, by parameter, of those that can be seen.
    effects: cosine of what the typical size of a mechanism changes, by mechanism, of those that can be seen.
    vectors: random ones.  seconds: of driving.
  """

  speed: Pair
  channels: dict[str, float]
  drawn: dict[str, Array]
  worst: dict[str, str]
  slopes: dict[str, float]
  effects: dict[str, float]
  vectors: int
  seconds: float


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
  recordings = [r for r in dataset.recordings if r.role != "holdout"]
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  mechanisms = [m for m in catalogue().values() if vehicle.drive in m.drives]
  twins = {engine: Twin(vehicle, mechanisms, substeps=2, engine=engine) for engine in ("mujoco", "reduced")}
  seen = observe(recordings, vehicle, Cut(most=most))
  noise = np.array([sensor_floor(noise_passport(recordings)).get(name, np.nan) for name in CHANNELS])[seen.channel]
  keep = np.isfinite(noise) & (noise > 0.0)

  def answers(thetas: Array) -> tuple[Array, Array]:
    both = (seen.predict(twins[e].rollout(thetas, seen.stretches.segments)) / noise for e in ("mujoco", "reduced"))
    exact, reduced = (np.where(keep, values, 0.0) for values in both)
    return exact, reduced

  def by_channel(wrong: Array) -> dict[str, float]:
    rows = {name: seen.select(name) & keep for name in seen.present}
    return {name: float(np.sqrt(np.mean(wrong[r] ** 2))) for name, r in rows.items() if r.any()}

  progress("speed")
  speed = _speed(vehicle)
  base, nominal = twins["mujoco"].base, twins["mujoco"].parameters.nominal
  progress("random parameters")
  rng = np.random.default_rng(seed)
  spread = np.where([p.std is None for p in base], base.scale / 3.0, base.std)
  moves = rng.standard_normal((vectors, len(base))) * spread
  drawn = np.tile(nominal, (vectors + 1, 1))
  drawn[1:, : len(base)] = np.clip(base.nominal + moves, base.lower, base.upper)
  differences = []
  for k in range(0, len(drawn), 8):
    exact, reduced = answers(drawn[k : k + 8])
    differences += list(reduced - exact)
    progress("random parameters", min(k + 8, len(drawn)) / len(drawn))
  channels = by_channel(differences[0])
  table = [by_channel(d) for d in differences[1:]]
  worst = {n: _worst(differences[0], seen.select(n), seen.recording, seen.names) for n in channels}
  progress("slopes and effects")
  names, moved = [], [nominal]
  for i, p in enumerate(base):
    names.append(p.name)
    step = _STEP * base.scale[i]
    moved.append(_changed(nominal, i, step if nominal[i] + step < base.upper[i] else -step))
  for m in mechanisms:
    names.append(m.name)
    moved.append(nominal.copy())
    for p in m.parameters:
      if p.null is not None:
        moved[-1][twins["mujoco"].parameters.index(p.name)] = p.null + (p.typical or p.scale)
  exact, reduced = answers(np.stack(moved))
  change, other = exact[1:] - exact[0], reduced[1:] - reduced[0]
  size = np.sqrt(np.sum(change**2, axis=1))
  cosine = np.sum(change * other, axis=1) / np.maximum(size * np.sqrt(np.sum(other**2, axis=1)), 1e-300)
  whole = np.where(np.arange(len(names)) < len(base), size / _STEP, size)
  found = {n: float(c) for n, c, w in zip(names, cosine, whole, strict=True) if 0.5 * w**2 > _VISIBLE}
  return Agreement(
    speed=speed,
    channels=channels,
    drawn={n: np.array([row[n] for row in table]) for n in channels},
    worst=worst,
    slopes={n: c for n, c in found.items() if n in base},
    effects={n: c for n, c in found.items() if n not in base},
    vectors=vectors,
    seconds=float(seen.stretches.segments.steps.sum()) * 0.01,
  )


def _changed(theta: Array, i: int, step: float) -> Array:
  out = theta.copy()
  out[i] += step
  return out


def _worst(wrong: Array, rows: NDArray[np.bool_], recording: NDArray[np.int64], names: tuple[str, ...]) -> str:
  power = np.bincount(recording[rows], wrong[rows] ** 2, minlength=len(names))
  return f"{names[int(np.argmax(power))]}, {power.max() / max(power.sum(), 1e-300):.0%} of the squares"


def _speed(vehicle: Vehicle, cars: int = 256, periods: int = 20, rounds: int = 15) -> Pair:
  """10 ms of a car that drives and steers, by the processor's time of one thread."""
  sides = []
  for engine in ("mujoco", "reduced"):
    twin = Twin(vehicle, substeps=2, threads=1, engine=engine)
    sides.append(twin.begin(np.tile(twin.parameters.nominal, (cars, 1)), np.zeros((cars, 7))))
  commands = np.tile([1.5, 0.15], (cars, 1))
  drive = lambda simulation: [simulation.step(commands) for _ in range(periods)]
  with timers_stopped():
    for side in sides:
      drive(side)
    first, second, ratio = paired(lambda: drive(sides[0]), lambda: drive(sides[1]), rounds, time.process_time)
  each = (first / periods / cars, second / periods / cars)
  return Pair(f"10 ms, {cars} cars side by side", ("MuJoCo", "reduced car"), each, "car", ratio, 25.0, at_most=False)
