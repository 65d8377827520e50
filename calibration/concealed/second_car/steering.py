"""Servo with a time constant and a largest speed, a linkage with play, a trapezium of tie rods."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from .drive import swallowed
from .states import State

CARRIED = 1.5e-3  # s in which the horn carries the linkage along


def steering_rates(car: SimpleNamespace, state: State, rate: State, command: np.ndarray) -> None:
  """Servo: speed S p / sqrt(1 + p^2), p = error / (S T). Linkage: carried by whichever edge of the play it touches."""
  goal = swallowed(np.clip(command, -car.max_steering, car.max_steering), car.steering_zone)
  pull = (goal - state.servo) / (car.servo_time * car.servo_speed)
  rate.servo[:] = car.servo_speed * pull / np.sqrt(1.0 + pull * pull)
  gap, half = state.servo - state.linkage, 0.5 * car.steering_play
  rate.linkage[:] = (gap - np.clip(gap, -half, half)) / CARRIED


def mean_angle(car: SimpleNamespace, linkage: np.ndarray) -> np.ndarray:
  """Angle of a wheel in the middle [rad]: longer tie rods and a horn put on askew included."""
  return car.steering_gain * linkage + car.steering_trim


def road_wheels(car: SimpleNamespace, linkage: np.ndarray) -> np.ndarray:
  """Angles of the wheels (4, n) [rad]: cot left = cot mean - share track / 2 L, cot right the same with a plus."""
  middle = np.tan(mean_angle(car, linkage))
  apart = car.ackermann * 0.5 * car.track_width / (car.cg_to_front + car.cg_to_rear) * middle
  straight = np.zeros_like(middle)
  return np.stack([np.arctan(middle / (1.0 - apart)), np.arctan(middle / (1.0 + apart)), straight, straight])
