"""Families of circumstances a nameless error may depend on, as features on the control grid.

Features come from commands and the twin's own motion; only place and heading are measured. All are of
order one, so that one prior suits every coefficient.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.circumstances import LAGS, held_commands, lagged
from calibration.fitting.observations import Observations
from qcar_twin.plant import Prediction
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

# m/s, rad/s, m/s^2: squashed beyond; of the QCar's class, as all numbers here
_MOTION = {"velocity_x": 1.5, "yaw_rate": 1.5, "accel_x": 2.0, "accel_y": 3.0}
_BUMPS = 6  # per side of the floor that was driven: what bends a sensor near one place is half a metre wide
_MEMORIES = (0.8, 3.0, 10.0)  # s


def motion(observations: Observations, prediction: Prediction) -> Array:
  """Monomials up to degree two of squashed speed, yaw rate and accelerations, (S, T + 1, 15)."""
  scales = motion_scales(observations.vehicle)
  columns = [np.tanh(prediction.channel(name)[0] / scale) for name, scale in scales.items()]
  return monomials(columns, terms(len(columns)))


def motion_scales(vehicle: Vehicle) -> dict[str, float]:
  """Speed [m/s], yaw rate [rad/s] and accelerations [m/s^2] that a car of this size usually has."""
  by = {"velocity_x": vehicle.similarity.speed, "yaw_rate": 1.0 / vehicle.similarity.time}
  return {name: scale * by.get(name, 1.0) for name, scale in _MOTION.items()}


def past_commands(observations: Observations, prediction: Prediction) -> Array:
  """Voltage and steering now and up to 0.4 s ago, their magnitudes and squares, (S, T + 1, 17)."""
  segments = observations.stretches.segments
  vehicle = observations.vehicle
  drive = 2.0 * (vehicle.similarity.speed if vehicle.drive == "speed" else 1.0)
  u = np.stack(held_commands(segments.commands), axis=-1) / [drive, 0.25]
  past = [lagged(u, int(round(lag / segments.period))) for lag in LAGS]
  ones = np.ones((*u.shape[:2], 1))
  return np.concatenate([ones, *past, np.abs(u), u * np.abs(u), u**2], axis=-1)


def heading(observations: Observations, prediction: Prediction) -> Array:
  """First and second harmonics of the measured heading, alone and for a moving car, (S, T + 1, 8); without one none.

  Where a recording lacks it they are nought, and say nothing.
  """
  pose = observations.stretches.segments.pose
  if pose is None or not np.isfinite(pose[..., 2]).any():
    return np.zeros((*prediction.channel("yaw_rate")[0].shape, 0))
  yaw = pose[..., 2]
  waves = [np.nan_to_num(wave(k * yaw)) for k in (1, 2) for wave in (np.cos, np.sin)]
  moving = np.tanh(prediction.channel("velocity_x")[0] / (0.3 * observations.vehicle.similarity.speed))
  return np.stack([*waves, *(moving * wave for wave in waves)], axis=-1)


def places(observations: Observations, prediction: Prediction) -> Array:
  """Bumps over the floor that was driven, (S, T + 1, 36); nought where a recording lacks a place, none without one."""
  pose = observations.stretches.segments.pose
  if pose is None or not np.isfinite(pose[..., :2]).all(axis=-1).any():
    return np.zeros((*prediction.channel("yaw_rate")[0].shape, 0))
  low, high = np.nanquantile(pose[..., :2].reshape(-1, 2), [0.02, 0.98], axis=0)
  width = np.maximum(high - low, 0.2 * observations.vehicle.similarity.length) / (_BUMPS - 1)
  share = (pose[..., :2] - low) / width
  knots = itertools.product(range(_BUMPS), repeat=2)
  bumps = [np.exp(-0.5 * np.sum((share - np.array(k)) ** 2, axis=-1)) for k in knots]
  return np.nan_to_num(np.stack(bumps, axis=-1))


def histories(observations: Observations, prediction: Prediction) -> Array:
  """Leaky means of cornering and drive power over the last seconds, times what the car feels now, (S, T + 1, 24)."""
  usual = motion_scales(observations.vehicle)
  sliding = np.abs(prediction.channel("accel_y")[0] * prediction.channel("velocity_x")[0])
  sliding /= 3.0 * observations.vehicle.similarity.speed
  driving = (
    np.abs(prediction.channel("motor_speed")[0] * held_commands(observations.stretches.segments.commands)[0]) / 300.0
  )
  now = [np.tanh(prediction.channel(name)[0] / usual[name]) for name in ("accel_x", "accel_y", "yaw_rate")]
  kept = [np.tanh(_leaky(x, memory / prediction.period)) for x in (sliding, driving) for memory in _MEMORIES]
  return np.stack([past * x for past in kept for x in (np.ones_like(sliding), *now)], axis=-1)


def terms(count: int) -> list[tuple[int, ...]]:
  """Index tuples of monomials up to degree two: (), (0,), (1,), ..., (0, 0), (0, 1), ..."""
  return [t for degree in (0, 1, 2) for t in itertools.combinations_with_replacement(range(count), degree)]


def monomials(columns: Sequence[Array], chosen: Sequence[tuple[int, ...]]) -> Array:
  """Products of columns (...), stacked last, (..., K)."""
  ones = np.ones_like(columns[0])
  return np.stack([np.prod([columns[i] for i in term], axis=0) if term else ones for term in chosen], axis=-1)


def _leaky(values: Array, steps: float) -> Array:
  """First-order mean of values (S, T) over the last steps, zero at the start of a stretch."""
  out, keep = np.zeros_like(values), np.exp(-1.0 / steps)
  for k in range(1, values.shape[1]):
    out[:, k] = keep * out[:, k - 1] + (1.0 - keep) * values[:, k - 1]
  return out
