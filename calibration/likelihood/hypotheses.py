"""What may be wrong with a twin, as blocks of parameters with a Gaussian prior: absence is their null value.

A hypothesis is a named mechanism from one of its starts, an error that every model allows for but larger than that, or
a force without a name that is a function of state, commands, place, heading, time or history. All are weighed in the
same currency: the marginal likelihood of the linear-Gaussian model around a place, in nats.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.likelihood.linear import Place
from calibration.likelihood.readings import EVERY, Readings
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.twin.mechanisms.base import Mechanism

Array = NDArray[np.float64]

BELIEVED = 2.0  # typical sizes: prior standard deviation of an amplitude
_ASKED = 0.3  # of the typical size, over which a response is taken
_PUSH = 0.01  # of the weight: prior standard deviation of a nameless force
_BUMPS = 4  # along each side of the floor, of a force that depends on place
_MEMORIES = (1.0, 10.0)  # s, of a force that depends on history


@dataclasses.dataclass(frozen=True)
class Option:
  """A mechanism from one start.

  Attributes:
    name: of the mechanism; amplitudes, shapes: its parameters, with priors; start: values of the shapes.
  """

  name: str
  amplitudes: tuple[Parameter, ...]
  shapes: tuple[Parameter, ...]
  start: Mapping[str, float]

  @property
  def key(self) -> str:
    return self.name + "".join(f" {n}={v:.3g}" for n, v in self.start.items())

  def freed(self, base: ParameterSet) -> ParameterSet:
    """The base parameters and this one's, which replace what the base allows of the same."""
    own = {p.name for p in (*self.amplitudes, *self.shapes)}
    return ParameterSet([p for p in base if p.name not in own]) + [*self.amplitudes, *self.shapes]


def options(mechanisms: Sequence[Mechanism], base: ParameterSet, readings: Readings) -> list[Option]:
  """All named hypotheses that the recordings' channels can show; sensors' own errors, which every model fits, are none.

  Args:
    mechanisms: to be considered.  base: what every model fits.
  """
  driving, found = readings.segments.driving, []
  for m in mechanisms:
    if any(n in base and base[n].upper == p.upper for p in m.parameters if (n := p.name)):
      continue
    if set(m.needs) - set(readings.channels):
      continue
    amplitudes = tuple(
      dataclasses.replace(
        p, std=BELIEVED * p.typical, nominal=p.null, step=base[p.name].std if p.name in base else p.step
      )
      for p in m.parameters
      if p.null is not None and p.typical
    )
    shapes = [p for p in m.parameters if p.null is None]
    for guess in m.initial_guesses(driving):
      placed = tuple(dataclasses.replace(p, nominal=guess.get(p.name, p.nominal)) for p in shapes)
      found.append(Option(m.name, amplitudes, placed, {p.name: p.nominal for p in placed if p.name in guess}))
  return found


def responses(place: Place, asked: Sequence[Option]) -> tuple[Array, Array, list[slice]]:
  """Columns of all amplitudes, compressed (J, rows, p), of ends (J, 7, p), and each option's among them."""
  theta, moves, where, first = [], [], [], 0
  for option in asked:
    for p in option.amplitudes:
      vector, i = place.theta.copy(), place.twin.parameters.index(p.name)
      for shape in option.shapes:
        vector[place.twin.parameters.index(shape.name)] = shape.nominal
      step = _ASKED * (p.step or p.typical or p.scale)
      step = step if vector[i] + step <= p.upper else -step
      vector[i] += step
      theta.append(vector)
      moves.append(step)
    where.append(slice(first, first + len(option.amplitudes)))
    first += len(option.amplitudes)
  return *place.columns(np.array(theta), np.array(moves)), where


@dataclasses.dataclass(frozen=True)
class Weighed:
  """What hypotheses would bring at a place, nats, and by chance.

  Attributes:
    gain: log marginal likelihood ratio against the base, (H,); size: estimates in standard deviations of the prior.
    chance: the largest gain of all hypotheses under random signs of the blocks' scores, (draws,).
  """

  gain: Array
  size: list[Array]
  chance: Array


def weigh(
  base: Array, base_precision: Array, pull: Array, blocks: NDArray[np.intp], residual: Array, columns: Array,
  where: Sequence[slice], width: Array, one_sided: NDArray[np.bool_], draws: int, seed: int = 0,
) -> Weighed:  # fmt: skip
  """Marginal likelihoods by linear algebra, without simulation.

  Args:
    base: whitened columns of the base, (J, r, p); base_precision: (p, p) of its posterior; pull: of its prior, (p,).
    blocks: block of each window, (J,).  residual: whitened, (J, r).
    columns: of all hypotheses, (J, r, k), divided by nothing.  where: each one's columns.
    width: prior standard deviation of every column, (k,).  one_sided: whether a negative size means nothing, (k,).
    draws: of random signs, which leave a block's own correlations alone.
  """
  columns = columns * width
  flat, below = columns.reshape(-1, columns.shape[2]), base.reshape(-1, base.shape[2])
  cross = np.linalg.solve(base_precision, below.T @ flat)  # (p, k)
  count = int(blocks.max()) + 1
  score = _by_block(np.einsum("jrk,jr->jk", columns, residual), blocks, count)
  score = score - _by_block(np.einsum("jrp,jr->jp", base, residual), blocks, count) @ cross
  gram = flat.T @ flat - (below.T @ flat).T @ cross
  total = score.sum(axis=0) + pull @ cross
  gain, size, solved = np.zeros(len(where)), [], []
  for h, part in enumerate(where):
    precision = gram[part, part] + np.eye(part.stop - part.start)
    inverse, logs = np.linalg.inv(precision).astype(np.float64), 0.5 * np.linalg.slogdet(precision)[1]
    value = inverse @ total[part]
    size.append(value)
    solved.append((part, inverse, logs))
    gain[h] = _worth(total[None, part], inverse, one_sided[part])[0] - logs
  # by chance: what the best of them explains is no chance and is taken off first
  best = where[int(np.argmax(gain))]
  clean = columns - base @ cross
  score = score - _by_block(
    np.einsum("jrk,jr->jk", clean, clean[:, :, best] @ size[int(np.argmax(gain))]), blocks, count
  )
  flipped = np.random.default_rng(seed).choice([-1.0, 1.0], (draws, count)) @ score
  chance = np.max([_worth(flipped[:, part], inverse, one_sided[part]) - logs for part, inverse, logs in solved], axis=0)
  return Weighed(gain, size, chance)


def _by_block(values: Array, blocks: NDArray[np.intp], count: int) -> Array:
  out = np.zeros((count, values.shape[1]))
  np.add.at(out, blocks, values)
  return out


def _worth(score: Array, inverse: Array, one_sided: NDArray[np.bool_]) -> Array:
  """Half the squared score of each row, 0 where a single amplitude would have the wrong sign."""
  value = 0.5 * np.einsum("di,ij,dj->d", score, inverse, score)
  if len(one_sided) == 1 and one_sided[0]:
    value = np.where(score[:, 0] > 0.0, value, 0.0)
  return value


def families(readings: Readings, starts: Array) -> dict[str, Array]:
  """Functions that a nameless force may be of, each (J, k) with mean square 1 or less."""
  v, r, x, y, yaw = (starts[:, i] for i in (0, 3, 4, 5, 6))
  every_command = readings.segments.commands
  middle = np.minimum(readings.first_period + EVERY // 2, every_command.shape[1] - 1)
  commands = every_command[readings.stretch, middle]
  drive, steer = commands.T
  history = readings.segments.history
  spent = np.zeros(len(readings)) if history is None else history[readings.stretch, 0]
  time = spent + readings.first_period * readings.segments.period
  window = EVERY * readings.segments.period
  past = [_faded(p, readings.begins, window, t) for p in (drive**2, np.abs(v * r)) for t in _MEMORIES]
  along = [(np.linspace(np.quantile(c, 0.02), np.quantile(c, 0.98), _BUMPS)) for c in (x, y)]
  wide = [max(float(np.ptp(m)) / (_BUMPS - 1), 0.1) for m in along]
  bumps = [np.exp(-0.5 * ((x - a) / wide[0]) ** 2 - 0.5 * ((y - b) / wide[1]) ** 2) for a in along[0] for b in along[1]]
  made = {
    "state": [v, v * np.abs(v), r, v * r, r * np.abs(r), np.sign(v)],
    "commands": [drive, steer, drive * np.abs(drive), steer * np.abs(steer), drive * steer],
    "place": bumps,
    "heading": [np.sin(yaw), np.cos(yaw), np.sin(2.0 * yaw), np.cos(2.0 * yaw)],
    "history": past,
    "time": [time, time**2, (time > np.median(time)).astype(float)],
  }
  out = {}
  for name, columns in made.items():
    table = np.stack(columns, axis=1)
    table = table if name == "place" else table - table.mean(axis=0)
    out[name] = table / (np.sqrt(np.mean(table**2, axis=0)) + 1e-9)
  return out


def _faded(value: Array, begins: NDArray[np.bool_], window: float, memory: float) -> Array:
  """First-order lag of a value along its chain, (J,)."""
  out, keep, now = np.empty(len(value)), np.exp(-window / memory), 0.0
  for j in range(len(value)):
    now = 0.0 if begins[j] else keep * now + (1.0 - keep) * value[j - 1]
    out[j] = now
  return out


def pushed(place: Place, table: Array) -> tuple[Array, Array, Array]:
  """Columns of forces along, across and about that follow functions (J, k), and their priors' widths, (3 k,)."""
  readings, ends = place.force_columns()
  made = np.einsum("jrd,jk->jrdk", readings, table).reshape(*readings.shape[:2], -1)
  gone = np.einsum("jxd,jk->jxdk", ends, table).reshape(*ends.shape[:2], -1)
  weight = _PUSH * place.twin.vehicle.mass * 9.81
  width = weight * np.array([1.0, 1.0, place.twin.car.wheelbase / 4.0])
  return made, gone, np.repeat(width, table.shape[1])
