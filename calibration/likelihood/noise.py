"""What is not physics: white noise of the sensors by speed, coloured errors of poses, biases of a run, forces.

Sensor noise is read off fourth differences, which no motion makes (see fitting/noise_floor.py), so that it cannot
swallow physics; the forces and the localisation's slow errors have no such witness and are fitted by likelihood.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from calibration.fitting.noise import noise_passport
from calibration.fitting.noise_floor import driving_noise, rough_differences
from calibration.fitting.residual_channels import POSE, RESIDUALS
from calibration.likelihood.readings import EVERY, Readings
from qcar_twin.kinematics import road_speed
from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]

MOVES = 0.1  # m/s: a car that stands is pushed by nothing: roads and draughts come with motion
BIASED = {"accel_x": 0.02, "accel_y": 0.02, "yaw_rate": 0.002}  # m/s^2, rad/s: wander of a bias between runs
# degrees of freedom of the readings' distribution, with which a fast mode that the twin lacks (a shaft that rings after
# a jolt, wheels that slide) spoils a window and no more: Lange, Little and Taylor, J. Am. Stat. Assoc. 84, 1989, take 4
TAIL = 4.0
_LEAST_TRUST = 1e-4
_BINS = 8  # of speed, in which a sensor's noise is read off
_NORMAL = 1.4826
# of what fourth differences of poses see: the rest is their slow error's, whose memory is a few samples
_WHITE = 0.7

# of the fitted numbers: start, lower and upper bound
FITTED = {
  "force_x": (0.08, 1e-3, 20.0),  # N
  "force_y": (0.1, 1e-3, 20.0),  # N
  "moment": (0.008, 1e-5, 1.0),  # N m
  "memory": (0.4, 0.03, 2.0),  # s
  "load_share": (0.02, 1e-3, 1.0),  # of the tyres' force, that comes and goes with the floor
  "pose_slow": (0.01, 1e-4, 0.1),  # m
  "pose_slow_yaw": (0.008, 1e-4, 0.1),  # rad
  "pose_memory": (1.0, 0.05, 3.0),  # s
}
POSE_NUMBERS = 3  # of these, the last


@dataclasses.dataclass(frozen=True)
class Noise:
  """Attributes:
  still, by_speed: white noise of each channel: sqrt(still^2 + (by_speed v)^2), v in m/s.
  fitted: logarithms of the numbers of FITTED, in their order.
  trust: precision of every window's readings of a channel relative to that, (J, channels), with a Gamma(TAIL / 2,
    TAIL / 2) prior: readings are Student's, window by window and channel by channel.
  """

  still: dict[str, float]
  by_speed: dict[str, float]
  fitted: Array
  trust: Array

  def value(self, name: str) -> float:
    return float(np.exp(self.fitted[list(FITTED).index(name)]))

  def white(self, readings: Readings, speed: Array) -> Array:
    """Standard deviation at every place for a reading, (J, m), at speeds (J,)."""
    out = np.empty(readings.measured.shape)
    for c, name in enumerate(readings.channels):
      columns = readings.channel == c
      white = np.hypot(self.still[name], self.by_speed[name] * speed) / np.sqrt(self.trust[:, c])
      out[:, columns] = white[:, None]
    return out

  def distrust(self, readings: Readings) -> float:
    """What the trusts cost: their prior, and the width they give to the readings, nats."""
    count = np.stack(
      [readings.used[:, readings.channel == c].sum(axis=1) for c in range(len(readings.channels))], axis=1
    )
    logs = np.log(self.trust)
    return float(np.sum(0.5 * TAIL * (self.trust - 1.0 - logs) - 0.5 * count * logs))

  def heeding(self, readings: Readings, residual: Array) -> "Noise":
    """The same with the trusts that residuals (J, m), in standard deviations of this noise, make most likely."""
    trust = np.ones_like(self.trust)
    for c in range(len(readings.channels)):
      columns = readings.channel == c
      square = np.sum(residual[:, columns] ** 2, axis=1) / self.trust[:, c]
      trust[:, c] = (TAIL + readings.used[:, columns].sum(axis=1)) / (TAIL + square)
    return dataclasses.replace(self, trust=np.maximum(trust, _LEAST_TRUST))

  def scales(self, speed: Array, load: Array, wheelbase: float, biased: int) -> Array:
    """Standard deviations of the states beyond the motions, (J, n - 7): forces, pose errors, biases.

    Args:
      speed: m/s, (J,).  load: force of the tyres on the car, N, (J,).
    """
    own = self.value("load_share") * load
    moving = np.tanh(np.abs(speed) / MOVES)
    forces = [np.hypot(self.value("force_x"), own), np.hypot(self.value("force_y"), own)]
    forces.append(np.hypot(self.value("moment"), own * wheelbase / 4.0))
    poses = [np.full(len(speed), self.value(n)) for n in ("pose_slow", "pose_slow", "pose_slow_yaw")]
    columns = [f * moving for f in forces] + poses + [np.full(len(speed), s) for s in list(BIASED.values())[:biased]]
    return np.stack(columns, axis=1)

  def memory(self, period: float, biased: int) -> Array:
    """Share of the same that is left after a window."""
    window = EVERY * period
    left = [np.exp(-window / self.value("memory"))] * 3 + [np.exp(-window / self.value("pose_memory"))] * 3
    return np.array(left + [1.0] * biased)


def first_noise(recordings: Sequence[Recording], readings: Readings) -> Noise:
  """Sensor noise as the recordings show it, and a start for the rest."""
  passport, driving = noise_passport(recordings), driving_noise(recordings)
  still, by_speed = {}, {}
  for name in readings.channels:
    recorded = name if name in POSE else RESIDUALS[name].needs[0]
    if name in POSE:
      # what neighbouring poses don't share; slow errors show in it, too, and are fitted beside it
      still[name], by_speed[name] = _WHITE * driving[recorded], 0.0
      continue
    still[name], by_speed[name] = _by_speed(recordings, recorded, readings)
    floor = max(passport[recorded].quantum / np.sqrt(12.0) if np.isfinite(passport[recorded].quantum) else 0.0, 1e-9)
    still[name] = max(still[name], floor)
  start = np.log([value for value, _, _ in FITTED.values()])
  return Noise(still, by_speed, start, np.ones((len(readings), len(readings.channels))))


def _by_speed(recordings: Sequence[Recording], channel: str, readings: Readings) -> tuple[float, float]:
  """White noise at rest and per speed, by least squares over bins of equal count."""
  sizes, speeds = [], []
  for recording in recordings:
    if channel not in recording:
      continue
    time, size = rough_differences(recording[channel])
    name = next((n for n in ("motor_speed", "speed") if n in recording), None)
    if name is None:
      speed = np.zeros(len(time))
    else:
      speed = np.abs(np.interp(time, recording[name].time, recording[name].value))
      speed = road_speed(speed, readings.vehicle) if name == "motor_speed" else speed
    sizes.append(size)
    speeds.append(speed)
  size, speed = np.concatenate(sizes), np.concatenate(speeds)
  rolls = speed > MOVES
  if rolls.sum() > 10 * _BINS:  # an encoder shows nothing at rest and is full of noise from the first turn on
    size, speed = size[rolls], speed[rolls]
  order = np.argsort(speed, kind="stable")
  parts = [p for p in np.array_split(order, _BINS) if len(p)]
  variance = np.array([(_NORMAL * np.median(size[p])) ** 2 for p in parts])
  square = np.array([np.mean(speed[p] ** 2) for p in parts])
  weight = 1.0 / np.maximum(variance, 1e-3 * variance.max() + 1e-300)
  solution = nnls(np.column_stack([np.ones(len(parts)), square]) * weight[:, None], variance * weight)[0]
  return float(np.sqrt(solution[0])), float(np.sqrt(solution[1]))
