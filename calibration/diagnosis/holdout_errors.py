"""Errors before and after the repair, on recordings that took no part, against the noise floor.

"Before" is the recalibrated twin, never an uncalibrated one. The hold-out is opened here, for what is named.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.decision.evidence import HeldOutError
from calibration.fitting.noise_floor import driving_noise, residual_floor
from calibration.fitting.observations import UNITS, Observations, observe
from calibration.fitting.windows import Cut
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ChannelFit:
  """Root mean square error of one channel before and after the repair, in its unit.

  Attributes:
    noise_floor, driving_noise: of the sensors at standstill and while driving, in the channel's unit.
    ci95: bounds of after / before - 1 by a block bootstrap: negative is an improvement; NaN of a single block, which
      shows no scatter.
  """

  before: float
  after: float
  noise_floor: float
  driving_noise: float
  ci95: tuple[float, float]
  unit: str
  samples: int

  @property
  def noise(self) -> float:
    """What the sensor itself makes, at standstill or while driving, whichever is more; in the channel's unit."""
    return max(self.noise_floor, self.driving_noise)


def held_out_error(role: str, channel: str, fit: ChannelFit) -> HeldOutError:
  """A channel's errors as evidence."""
  return HeldOutError(role, channel, fit.before, fit.after, fit.ci95, fit.noise, fit.unit, fit.samples)


@dataclasses.dataclass(frozen=True, eq=False)
class Replay:
  """Recordings that took no part in a fit, with the errors that twins make on them.

  Attributes:
    observations: M measured values.
    before, after: predicted minus measured of the recalibrated and the repaired twin, (M,), in each channel's unit.
    without: the same of the repaired twin without one of its mechanisms and with the rest refitted, by its name.
  """

  observations: Observations
  before: Array
  after: Array
  without: Mapping[str, Array] = dataclasses.field(default_factory=dict)


def compare_twins(
  twin: Twin,
  before: Array,
  after: Array,
  recordings: Sequence[Recording],
  floor: Mapping[str, float],
  cut: Cut,
  without: Mapping[str, Array] | None = None,
) -> tuple[dict[str, ChannelFit], Replay | None]:
  """Errors of two parameter vectors on recordings, per channel.

  Args:
    twin: the car with all mechanisms.
    before, after: parameter vectors, (P,).
    recordings: what to predict.
    floor: noise of each residual channel at standstill.
    cut: how recordings are cut; the timing that was fitted.
    without: parameter vectors of the repaired twin without one of its mechanisms, by its name, (P,) each.

  Returns:
    per channel; the errors value by value, None without recordings.
  """
  if not recordings:
    return {}, None
  observations, reduced = observe(recordings, twin.vehicle, cut), without or {}
  prediction = twin.rollout(np.stack([before, after, *reduced.values()]), observations.stretches.segments)
  errors = observations.predict(prediction) - observations.measured
  random = np.random.default_rng(0)
  driving = residual_floor(driving_noise(recordings))
  fits = {name: channel_fit(observations, errors, name, (floor, driving), random) for name in observations.present}
  return fits, Replay(observations, errors[0], errors[1], dict(zip(reduced, errors[2:], strict=True)))


def ratio(after: Mapping[str, float], before: Mapping[str, float]) -> float:
  """Geometric mean over the channels of both of after / before, errors in one unit per channel; 1 without any."""
  shares = [after[name] / before[name] for name in before if before[name] > 0.0 and after.get(name, 0.0) > 0.0]
  return float(np.exp(np.mean(np.log(shares)))) if shares else 1.0


def change(fits: Mapping[str, ChannelFit]) -> float:
  """Geometric mean over the channels of the errors, after over before; 1 without any."""
  return ratio({n: f.after for n, f in fits.items()}, {n: f.before for n, f in fits.items()})


def ratios(replay: Replay | None) -> dict[str, float]:
  """Error with each mechanism of a repaired twin over that without it, `change`; empty without recordings."""
  if replay is None:
    return {}
  rms = lambda error: {
    n: float(np.sqrt(np.mean(error[replay.observations.select(n)] ** 2))) for n in replay.observations.present
  }
  return {name: ratio(rms(replay.after), rms(error)) for name, error in replay.without.items()}


def recovered_share(fits: Mapping[str, ChannelFit]) -> float:
  """Share of the squared error above what the sensors make while driving that the repair removed; 0 without any."""
  floor = {name: f.noise for name, f in fits.items()}
  before, after = ({name: getattr(f, key) for name, f in fits.items()} for key in ("before", "after"))
  share = share_removed(before, after, floor)
  return 0.0 if share is None else share


def share_removed(before: Mapping[str, float], after: Mapping[str, float], floor: Mapping[str, float]) -> float | None:
  """Share of the squared error above a floor that is gone, every channel with the same weight; None without any.

    1 - sum_c (a_c^2 - f_c^2)+ / b_c^2 / sum_c (b_c^2 - f_c^2)+ / b_c^2

  A channel counts by how far it was above the floor in shares of its own error, so that neither a quiet sensor nor a
  channel that was at its floor from the start decides.

  Args:
    before, after, floor: root mean square errors b, a, f by channel, in one unit per channel; channels without a
      floor are left out.
  """
  names = [name for name in before if name in floor and before[name] > 0.0]
  above = lambda error: sum(max(error[n] ** 2 - floor[n] ** 2, 0.0) / before[n] ** 2 for n in names)
  excess = above(before)
  return 1.0 - above(after) / excess if excess > 0.0 else None


def share_taken_off(replay: Replay, fits: Mapping[str, ChannelFit], name: str) -> float | None:
  """What one mechanism takes off the recalibrated twin's squared error above sensor noise, as a share of it.

  The share that all mechanisms remove (`share_removed`) less the share that the others remove without it. Of a single
  mechanism this is `recovered_share`. None where the twin without it was not driven.
  """
  if name not in replay.without or not fits:
    return None
  select, error = replay.observations.select, replay.without[name]
  left = {channel: float(np.sqrt(np.mean(error[select(channel)] ** 2))) for channel in fits}
  others = share_removed({c: f.before for c, f in fits.items()}, left, {c: f.noise for c, f in fits.items()})
  return None if others is None else recovered_share(fits) - others


def channel_fit(
  observations: Observations,
  errors: Array,
  name: str,
  floors: tuple[Mapping[str, float], Mapping[str, float]],
  random: np.random.Generator,
) -> ChannelFit:
  """Errors of one channel before and after, with the interval of their ratio.

  Args:
    observations: M measured values.
    errors: predicted minus measured, before and after first, (2 or more, M).
    name: of the channel.
    floors: noise at standstill and while driving, by channel.
    random: of the bootstrap over blocks.
  """
  rows = observations.select(name)
  squares = errors[:2, rows] ** 2
  block = observations.block[rows]
  sums = np.stack([np.bincount(block, s) for s in squares])  # (2, B)
  sums = sums[:, np.bincount(block) > 0]
  picks = random.integers(0, sums.shape[1], (500, sums.shape[1]))
  ratio = np.sqrt(sums[1][picks].sum(axis=1) / np.maximum(sums[0][picks].sum(axis=1), 1e-30)) - 1.0
  before, after = np.sqrt(squares.mean(axis=1))
  low, high = np.quantile(ratio, [0.025, 0.975]) if sums.shape[1] > 1 else (np.nan, np.nan)
  still, driving = (float(floor.get(name, 0.0)) for floor in floors)
  return ChannelFit(float(before), float(after), still, driving, (float(low), float(high)),
                    UNITS[name], int(rows.sum()))  # fmt: skip
