"""S9, ship and show: errors before and after, on recordings that took no part, against the noise floor.

"Before" is the recalibrated twin, never an uncalibrated one. The hold-out is opened here, once.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.observations import UNITS, Observations, observe
from calibration.segmenting import Cut
from qcar_twin.recording import Recording
from qcar_twin.twin import Twin

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ChannelFit:
  """Root mean square error of one channel before and after the repair, in its unit.

  `ci95` bounds after / before - 1 by a block bootstrap: negative is an improvement.
  """

  before: float
  after: float
  noise_floor: float
  ci95: tuple[float, float]
  unit: str
  samples: int


def compare_twins(
  twin: Twin,
  before: Array,
  after: Array,
  recordings: Sequence[Recording],
  floor: Mapping[str, float],
  cut: Cut,
  seed: int = 0,
) -> tuple[dict[str, ChannelFit], Observations, Array]:
  """Errors of two parameter vectors on recordings, per channel.

  Args:
    twin: the car with all mechanisms.
    before, after: parameter vectors, (P,).
    recordings: what to predict.
    floor: noise of each residual channel.
    cut: how recordings are cut; the timing that was fitted.
    seed: of the bootstrap.

  Returns:
    per channel; the observations; errors (2, M) of before and after in each channel's unit.
  """
  if not recordings:
    return {}, _empty(), np.zeros((2, 0))
  observations = observe(recordings, twin.vehicle, cut)
  prediction = twin.rollout(np.stack([before, after]), observations.stretches.segments)
  errors = observations.predict(prediction) - observations.measured
  random = np.random.default_rng(seed)
  fits = {name: _channel(observations, errors, name, floor, random) for name in observations.present}
  return fits, observations, errors


def recovered_share(fits: Mapping[str, ChannelFit]) -> float:
  """Share of the error above the noise floor that the repair removed, over the channels with an excess."""
  excess = sum(max(f.before**2 - f.noise_floor**2, 0.0) / max(f.noise_floor, 1e-12) ** 2 for f in fits.values())
  left = sum(max(f.after**2 - f.noise_floor**2, 0.0) / max(f.noise_floor, 1e-12) ** 2 for f in fits.values())
  return 1.0 - left / excess if excess > 0 else 0.0


def _channel(
  observations: Observations, errors: Array, name: str, floor: Mapping[str, float], random: np.random.Generator
) -> ChannelFit:
  rows = observations.select(name)
  squares = errors[:, rows] ** 2
  block = observations.block[rows]
  sums = np.stack([np.bincount(block, s) for s in squares])  # (2, B)
  sums = sums[:, np.bincount(block) > 0]
  picks = random.integers(0, sums.shape[1], (500, sums.shape[1]))
  ratio = np.sqrt(sums[1][picks].sum(axis=1) / np.maximum(sums[0][picks].sum(axis=1), 1e-30)) - 1.0
  before, after = np.sqrt(squares.mean(axis=1))
  low, high = np.quantile(ratio, [0.025, 0.975])
  return ChannelFit(float(before), float(after), float(floor.get(name, 0.0)), (float(low), float(high)),
                    UNITS[name], int(rows.sum()))  # fmt: skip


def _empty() -> Observations:
  return None  # type: ignore[return-value]
