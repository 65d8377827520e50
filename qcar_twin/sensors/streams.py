"""Random numbers of N cars side by side: what a car gets does not depend on which other cars are drawn with it.

Counter-based: number k of a car is a function of the car's key and of k alone, so all cars are drawn in one go and a
stream's state is two arrays. SplitMix64 (Steele, Lea and Flood, Fast splittable pseudorandom number generators,
OOPSLA 2014), which passes BigCrush; normal numbers by Box and Muller (Ann. Math. Stat. 29, 1958).
"""

import copy
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Words = NDArray[np.uint64]
Shape = int | tuple[int, ...]
GAMMA = np.uint64(0x9E3779B97F4A7C15)  # the odd number next to 2^64 / golden ratio
MIX = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))
SHIFTS = (np.uint64(30), np.uint64(27), np.uint64(31))
REAL = np.uint64(11)  # bits of a word that a double's mantissa has no room for


class CarStreams:
  """Random streams of N cars with the methods of `numpy.random.Generator` that sensors use.

  Cars lie along the last axis of what is drawn with one or two axes, along the second of three: (N,), (k, N) or
  (k, N, c).

  Args:
    seeds: one per car.
    key: numbers that tell this stream from others of the same cars.
  """

  def __init__(self, seeds: Sequence[int], *key: int):
    self._key = np.array(
      [np.random.SeedSequence([seed, *key]).generate_state(1, np.uint64)[0] for seed in seeds], dtype=np.uint64
    )
    self._drawn = np.zeros(len(seeds), dtype=np.uint64)
    self._which: Mask | None = None

  def only(self, which: Mask) -> "CarStreams":
    """The same streams, of which a draw moves on the cars in `which` only; the others get what they will get again."""
    some = copy.copy(self)  # shares the counters
    some._which = which
    return some

  def random(self, size: Shape) -> Array:
    """Uniform in [0, 1)."""
    size = (size,) if isinstance(size, int) else size
    return _arranged(2.0**-53 * (self._words(size) >> REAL).astype(np.float64), size)

  def uniform(self, low: float, high: float, size: Shape) -> Array:
    """Uniform in [low, high)."""
    return low + (high - low) * self.random(size)

  def standard_normal(self, size: Shape) -> Array:
    """Mean 0, standard deviation 1."""
    size = (size,) if isinstance(size, int) else size
    words = self._words(size, even=True) >> REAL
    half = words.shape[1] // 2
    radius = np.sqrt(-2.0 * np.log((words[:, :half] + np.uint64(1)) * 2.0**-53))
    angle = 2.0 * math.pi * 2.0**-53 * words[:, half:]
    return _arranged(np.concatenate([radius * np.cos(angle), radius * np.sin(angle)], axis=1), size)

  def normal(self, loc: float, scale: float, size: Shape) -> Array:
    """Of mean `loc` and standard deviation `scale`."""
    return loc + scale * self.standard_normal(size)

  def _words(self, size: tuple[int, ...], even: bool = False) -> Words:
    """So many words of every car as `size` has, (N, m); an even number where asked."""
    count = len(self._key)
    if size[_axis(size)] != count:
      raise ValueError(f"{size} numbers do not lie along {count} cars: draw (N,), (k, N) or (k, N, c)")
    each = math.prod(size) // count
    each += each % 2 if even else 0
    word = self._drawn[:, None] + np.arange(1, each + 1, dtype=np.uint64)
    word *= GAMMA
    word += self._key[:, None]
    for shift, factor in zip(SHIFTS, MIX, strict=False):
      word ^= word >> shift
      word *= factor
    word ^= word >> SHIFTS[2]
    self._drawn += np.uint64(each) if self._which is None else np.where(self._which, each, 0).astype(np.uint64)
    return word


def own(rng: "np.random.Generator | CarStreams", which: Mask) -> "np.random.Generator | CarStreams":
  """What to draw from for some cars: streams of their own, or the one they share, in which all cars draw."""
  return rng.only(which) if isinstance(rng, CarStreams) else rng


def _axis(size: tuple[int, ...]) -> int:
  """Along which the cars lie."""
  return 1 if len(size) == 3 else -1


def _arranged(numbers: Array, size: tuple[int, ...]) -> Array:
  """Numbers of every car, (N, m), as an array of a size."""
  count = len(numbers)
  if len(size) == 3:
    return numbers[:, : size[0] * size[2]].reshape(count, size[0], size[2]).swapaxes(0, 1)
  return numbers[:, : math.prod(size) // count].T.reshape(size)
