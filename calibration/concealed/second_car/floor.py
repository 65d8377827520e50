"""A floor that is not flat: waves of many lengths and headings, and a place with another grip."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

WAVES = 10
LENGTHS = (0.12, 2.5)  # m
STEEPNESS = 1.2e-3  # rms slope of the whole
EDGE = 0.06  # m, width of the patch's rim


class Floor:
  """Height h = sum a sin(k x + l y + phase) of one room; `level` scales it, at 0 it is flat."""

  def __init__(self, rng: np.random.Generator, level: float) -> None:
    length = LENGTHS[0] * (LENGTHS[1] / LENGTHS[0]) ** rng.uniform(0.0, 1.0, WAVES)
    heading, phase = rng.uniform(-np.pi, np.pi, (2, WAVES))
    number = 2 * np.pi / length
    self.along, self.across = number * np.cos(heading), number * np.sin(heading)
    self.phase, self.level = phase, level
    self.height = level * STEEPNESS * np.sqrt(2.0 / WAVES) / number  # every wave has the same share of the slope
    self.slopes = np.stack([self.height * self.along, self.height * self.across], axis=1)

  def at(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height [m] and slopes along the room's x and y, each of the shape of x."""
    if self.level == 0.0:
      nothing = np.zeros_like(x)
      return nothing, nothing, nothing
    turn = np.multiply.outer(x, self.along) + np.multiply.outer(y, self.across) + self.phase
    slopes = np.cos(turn) @ self.slopes
    return np.sin(turn) @ self.height, slopes[..., 0], slopes[..., 1]


def grip(car: SimpleNamespace, x: np.ndarray, y: np.ndarray) -> np.ndarray:
  """Factor on friction where the wheels (4, n) stand."""
  if not car.patch_loss.any():
    return np.ones_like(x)
  outside = (np.hypot(x - car.patch_x, y - car.patch_y) - car.patch_radius) / EDGE
  return 1.0 - car.patch_loss / (1.0 + np.exp(np.clip(outside, -40.0, 40.0)))
