"""How much an effect shows: the nats of the right model, reckoned with the generator's own car and nothing else.

The car is driven twice with the same commands, with the effect and without. What the sensors see differs by d, each
sample over its noise. Samples within 0.1 s count as one, displacements within their second, as in the product's unit
of evidence. What the car without an effect could imitate with other numbers is taken away:

    nats = min over a of  (|d(a)|^2 + a' P a) / 2

a: the generator's numbers that a recalibration may move, the small errors that every description of a car has
(UNSTATED), and constant errors of the IMU. P: the precision of what the owner states, and of those. Sizes are searched
with d(a) = d + J a, `shown`; what is stated of an effect is `absorbed`, where the car drives with the numbers moved: a
large effect bends the slopes, and a fit that goes on from there takes up more than they promise, or less.
Recordings that are held out to the end count nothing: a diagnosis does not look at them. So these are nats *after
absorption* by a perfect model of the car; `before` is |d|^2 / 2. They are an upper end of what a model sees whose own
errors exceed the noise.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from ..laboratory.manoeuvres import PERIOD
from .described import UNSTATED, WRAPPED
from .effects import Concealed, Effect, Nuisance
from .sensing import POSE_EVERY, sense
from .session import Setting, driven, observed, replayed

TOGETHER = round(0.1 / PERIOD)  # samples that count as one
HORIZON = round(1.0 / PERIOD)  # ticks that a displacement takes
LEAST, MOST = 5.0, 5000.0  # nats that targets are drawn between, log-uniformly
CLOSE = 0.05  # relative, of a target that is met
TRIES = 12
STRAIGHT = 0.05  # relative, or half a nat: so near what the slopes promise, nothing is bent
SETTLED = 0.01  # relative, of the last step's drop of the sum of squares
TRIALS = 16  # cars that are driven on the way, those for slopes aside
IMPOSSIBLE = 1e3  # noises, of every sample of a car that cannot be built
_RIGID = {"accel_x": "accel", "accel_y": "accel", "yaw_rate": "gyro", "motor_speed": "motor"}
_CONSTANT = ("accel_x", "accel_y", "yaw_rate")  # channels whose sensor has a constant error


@dataclass(frozen=True)
class Shown:
  """What an effect shows [nats]: after absorption, and before."""

  nats: float
  before: float


@dataclass
class Judge:
  """One car's sensors, and what its own numbers could imitate under the commands of its session without an effect."""

  setting: Setting
  commands: list[np.ndarray]
  traces: list[np.ndarray] = field(repr=False)
  plain: list[dict[str, np.ndarray]]
  imitation: np.ndarray = field(repr=False)
  precision: np.ndarray = field(repr=False)

  @classmethod
  def of(cls, setting: Setting) -> Judge:
    """Drives the session once, and once more for each number."""
    commands = driven(setting)
    traces = [replayed(setting.car, run, told) for run, told in zip(setting.runs, commands, strict=True)]
    judge = cls(setting, commands, traces, [], np.empty((0, 0)), np.empty(0))
    judge.plain = judge._seen((), ())
    stated = [0.0 if np.isinf(number.std) else number.std**-2 for number in judge._numbers]
    judge.precision = np.array([0.0] * len(_CONSTANT) + stated + [std**-2 for std in UNSTATED.values()])
    judge.imitation = np.stack(judge._constants(), axis=1)
    judge.imitation = judge._slopes((), np.zeros(len(judge.precision)))
    return judge

  def shown(self, concealed: Sequence[Concealed]) -> Shown:
    """Of all of them together. Raises ValueError where such a car is impossible."""
    return self._first_order(concealed)[0]

  def absorbed(self, concealed: Sequence[Concealed]) -> Shown:
    """Of all of them together, the numbers moved to where they leave least, by Levenberg's and Marquardt's method.

    A valley may be longer than TRIALS: what is returned is an upper end. Raises ValueError as `shown` does.
    """
    shown, start = self._first_order(concealed)
    prior = np.sqrt(self.precision)
    change = lambda a: np.concatenate([self._moved(concealed, a), prior * a])
    slopes: Any = lambda a: np.vstack([self._slopes(concealed, a), np.diag(prior)])  # scipy's stub knows names alone
    reached = 0.5 * float(np.sum(change(start) ** 2))
    if abs(reached - shown.nats) <= max(STRAIGHT * shown.nats, 0.5):
      return Shown(reached, shown.before)
    best = start if reached < shown.before else np.zeros(len(start))
    least = least_squares(change, best, slopes, method="lm", x_scale="jac", ftol=SETTLED, max_nfev=TRIALS)
    return Shown(float(least.cost), shown.before)

  @functools.cached_property
  def _numbers(self) -> list[Nuisance]:
    return list(self.setting.car.nuisances(self.setting.std).values())

  def _first_order(self, concealed: Sequence[Concealed]) -> tuple[Shown, np.ndarray]:
    """What is shown by the slopes alone, and the numbers' moves that leave that."""
    change = self._difference(concealed, ())
    usual = np.linalg.norm(self.imitation, axis=0) + 1e-12
    rows = np.vstack([self.imitation / usual, np.diag(np.sqrt(self.precision) / usual)])
    goal = np.concatenate([-change, np.zeros(len(usual))])
    best = np.linalg.lstsq(rows, goal, rcond=1e-9)[0]
    return Shown(0.5 * float(np.sum((goal - rows @ best) ** 2)), 0.5 * float(change @ change)), best / usual

  def _moved(self, concealed: Sequence[Concealed], moves: np.ndarray) -> np.ndarray:
    """Whitened change under effects with all numbers moved; IMPOSSIBLE where such a car cannot be built."""
    first, last = len(_CONSTANT), len(_CONSTANT) + len(self._numbers)
    small = [Concealed(n, WRAPPED[n], float(m)) for n, m in zip(UNSTATED, moves[last:], strict=True)]
    numbers = [(number, float(m)) for number, m in zip(self._numbers, moves[first:last], strict=True)]
    try:
      change = self._difference([*concealed, *small], numbers)
    except ValueError:
      return np.full(len(self.imitation), IMPOSSIBLE)
    return change + self.imitation[:, :first] @ moves[:first]

  def _slopes(self, concealed: Sequence[Concealed], moves: np.ndarray) -> np.ndarray:
    """Change of that by each number, by forward differences; constants of the IMU as they are."""
    constants = self.imitation[:, : len(_CONSTANT)]
    steps = [number.step for number in self._numbers] + list(UNSTATED.values())
    here, columns = self._moved(concealed, moves), []
    for i, step in enumerate(steps, constants.shape[1]):
      there = moves.copy()
      there[i] += step
      columns.append((self._moved(concealed, there) - here) / step)
    return np.column_stack([constants, *columns])

  def _seen(
    self, concealed: Sequence[Concealed], moved: Sequence[tuple[Nuisance, float]]
  ) -> list[dict[str, np.ndarray]]:
    quiet, rng = {name: 0.0 for name in _RIGID if name != "motor_speed"}, np.random.default_rng(0)
    traces = self.traces
    if moved or any(one.effect.how != "sensor" for one in concealed):
      runs = zip(self.setting.runs, self.commands, strict=True)
      traces = [replayed(self.setting.car, run, commands, concealed, moved) for run, commands in runs]
    return [sense(observed(trace, concealed), quiet, 0.0, rng) for trace in traces]

  def _difference(self, concealed: Sequence[Concealed], moved: Sequence[tuple[Nuisance, float]]) -> np.ndarray:
    """Whitened change of all that is seen of recordings that are not held out."""
    pairs = zip(self.setting.runs, self.plain, self._seen(concealed, moved), strict=True)
    return np.concatenate([self._whitened(plain, other) for run, plain, other in pairs if run.role != "holdout"])

  def _constants(self) -> list[np.ndarray]:
    """A unit on each channel of the IMU, whitened."""
    plains = [plain for run, plain in zip(self.setting.runs, self.plain, strict=True) if run.role != "holdout"]
    shifted = [[self._whitened(plain, {**plain, name: plain[name] + 1.0}) for plain in plains] for name in _CONSTANT]
    return [np.concatenate(rows) for rows in shifted]

  def _whitened(self, plain: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> np.ndarray:
    """Change from `plain` over the noise and over the root of the samples that count as one."""
    noise = self.setting.car.noise
    rows = [
      (other[name] - plain[name]) / (noise[kind] * np.sqrt(TOGETHER)) for name, kind in _RIGID.items()
    ]  # fmt: skip
    before, after = _displacements(plain), _displacements(other)
    moved = np.hypot(*before[:2])
    place = np.sqrt(2.0 * noise["pose"] ** 2 + (moved * noise["heading"]) ** 2)
    std = np.stack([place, place, np.full(len(moved), np.sqrt(2.0) * noise["heading"])])
    return np.concatenate([*rows, ((after - before) / (std * np.sqrt(HORIZON / POSE_EVERY))).ravel()])


def sized(judge: Judge, name: str, effect: Effect, sign: float, target: float) -> tuple[Concealed, Shown] | None:
  """The effect at the size that shows the target [nats], by secants of logarithms; at most at its largest.

  None where even its largest possible size shows less than LEAST.
  """
  low, high, size = 0.0, effect.most, 0.05 * effect.most
  best: tuple[Concealed, Shown] | None = None
  for _ in range(TRIES):
    one = Concealed(name, effect, sign * size)
    try:
      shown = judge.shown([one])
    except ValueError:  # no such car
      shown = None
    if shown is None or not np.isfinite(shown.nats):
      high = 0.7 * size
    elif best is None or abs(np.log(shown.nats + 1e-9) - np.log(target)) < abs(
      np.log(best[1].nats + 1e-9) - np.log(target)
    ):
      best = (one, shown)
    if shown is not None and abs(shown.nats / target - 1.0) < CLOSE:
      break
    size, low, high = _next(size, None if shown is None else shown.nats, target, low, high)
    if high <= low * (1.0 + 1e-3):
      break
  return best if best is not None and best[1].nats >= LEAST else None


def _next(size: float, nats: float | None, target: float, low: float, high: float) -> tuple[float, float, float]:
  """The next size, and the bracket that it lies in: nats go about with the square of the size."""
  if nats is None:
    return 0.5 * (low + high), low, high
  low, high = (size, high) if nats < target else (low, size)
  step = np.sqrt(target / nats) if nats > 1e-6 else 4.0
  wished = size * float(np.clip(step, 0.02, 20.0))
  if low < wished < high:
    return wished, low, high
  return (min(wished, high) if wished >= high > size else 0.5 * (low + high)), low, high


def _displacements(channels: dict[str, np.ndarray]) -> np.ndarray:
  """Way forward [m], to the left [m] and turn [rad] in each second, seen from the car: (3, K)."""
  x, y, yaw = (channels[f"pose_{name}"][::POSE_EVERY] for name in ("x", "y", "yaw"))
  apart = HORIZON // POSE_EVERY
  dx, dy, turn = (values[apart:] - values[:-apart] for values in (x, y, yaw))
  cos, sin = np.cos(yaw[:-apart]), np.sin(yaw[:-apart])
  return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn])
