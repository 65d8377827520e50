"""Understeer characteristic from a ramp steer, and the lateral acceleration up to which it is straight.

Steering is wound on slowly at constant speed; every moment is nearly a steady turn. Plotted is the angle
against lateral acceleration; where the speed strays, the angle is carried to the mean speed by
delta v^2 / v_mean^2, as it enters a_y of a linear car.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.identification.step_detection import PERIOD, moving_average
from qcar_twin.bicycle.bicycle import MeasuredCar
from qcar_twin.kinematics import road_speed
from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]

SMOOTHING = 0.5  # s, zero-phase moving average of speed, angle and acceleration
BIN = 0.1  # m/s^2
STRAIGHT = (0.3, 1.2)  # m/s^2, where the initial slope is read
TOLERANCE = 0.05  # departure of the angle from the initial line at which the linear range ends


@dataclasses.dataclass(frozen=True)
class Understeer:
  """Angle [rad] against lateral acceleration [m/s^2] in bins, at `speed` [m/s].

  Attributes:
    slope: of the initial line, rad s^2/m.
    linear_limit: lateral acceleration beyond which the angle stays 5 % off the initial line, m/s^2; the
      largest one reached if it never does.
    reached: largest lateral acceleration, m/s^2.
  """

  recording: str
  speed: float
  accel: tuple[float, ...]
  angle: tuple[float, ...]
  slope: float
  linear_limit: float
  reached: float


def understeer_characteristic(recordings: Sequence[Recording], vehicle: MeasuredCar) -> Understeer | None:
  """From the first ramp steer with a speed and accel_y (or yaw_rate) that reaches 1.5 m/s^2; None without one."""
  for recording in recordings:
    lateral = "accel_y" if "accel_y" in recording else "yaw_rate"
    needed = {lateral, "steering_command", "motor_speed" if "motor_speed" in recording else "speed"}
    if recording.manoeuvre != "ramp_steer" or not needed <= set(recording.channels):
      continue
    understeer = _characteristic(recording, lateral, vehicle)
    if understeer is not None:
      return understeer
  return None


def _characteristic(recording: Recording, lateral: str, vehicle: MeasuredCar) -> Understeer | None:
  speed, angle, accel = _smoothed(recording, lateral, vehicle)
  steered = np.abs(angle) > 0.02
  if not steered.any():
    return None
  first = int(np.argmax(steered))
  still = accel[: max(first - int(SMOOTHING / PERIOD), 1)]
  accel = np.sign(angle[-1]) * (accel - np.mean(still))[first:]
  mean_speed = float(np.mean(speed[first:]))
  angle = np.abs(angle[first:]) * np.square(speed[first:] / mean_speed)
  edges = np.arange(BIN, max(float(accel.max()), 0.0), BIN)
  rows = [np.abs(accel - edge) <= 0.5 * BIN for edge in edges]
  kept = [(float(edge), float(np.mean(angle[row]))) for edge, row in zip(edges, rows, strict=True) if row.any()]
  if not kept or kept[-1][0] < 1.5:
    return None
  levels, angles = np.array(kept).T
  straight = (levels >= STRAIGHT[0]) & (levels <= STRAIGHT[1])
  slope = float(levels[straight] @ angles[straight] / (levels[straight] @ levels[straight]))
  off = np.abs(angles / (slope * levels) - 1.0) > TOLERANCE
  within = np.flatnonzero(~off)
  limit = float(levels[within[-1]]) if within.size else float(levels[0])
  return Understeer(
    recording.name, mean_speed, tuple(levels.tolist()), tuple(angles.tolist()), slope, limit, float(levels[-1])
  )


def _smoothed(recording: Recording, lateral: str, vehicle: MeasuredCar) -> tuple[Array, Array, Array]:
  """Speed [m/s], steering angle [rad] and lateral acceleration [m/s^2] where all are logged."""
  columns = recording.resample(PERIOD)
  if "motor_speed" in columns:
    speed = road_speed(columns["motor_speed"], vehicle)
  else:
    speed = columns["speed"]
  there = np.isfinite(speed) & np.isfinite(columns[lateral])
  speed, angle = moving_average(speed[there], SMOOTHING), moving_average(columns["steering_command"][there], SMOOTHING)
  accel = moving_average(columns[lateral][there], SMOOTHING)
  return speed, angle, accel if lateral == "accel_y" else accel * speed
