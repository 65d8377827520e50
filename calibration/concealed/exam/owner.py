"""What the owner of an exam's car reads off a scale, a ruler, a data sheet, and a bounce test."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

STD = {
  "mass": 0.01, "yaw_inertia": 0.08, "cg_to_front": 0.01, "cg_to_rear": 0.01, "track_width": 0.005,
  "cg_height": 0.1, "wheel_radius": 0.006, "motor_constant": 0.03, "suspension_frequency": 0.05,
  "suspension_damping_ratio": 0.15,
}  # fmt: skip
"""Relative standard deviations."""
WORST = 2.0  # standard deviations; an owner who errs by more sees it, and measures again


def reading(true: float, std: float, rng: np.random.Generator) -> float:
  """A figure as it was read, in its own unit."""
  return true + std * float(np.clip(rng.standard_normal(), -WORST, WORST))


def readings(true: Mapping[str, float], rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
  """Figures of a [vehicle] table as they were read, and their standard deviations; the wheelbase itself is exact."""
  std = {name: STD[name] * value for name, value in true.items()}
  read = {name: reading(value, std[name], rng) for name, value in true.items()}
  read["cg_to_rear"] = true["cg_to_front"] + true["cg_to_rear"] - read["cg_to_front"]
  return read, std
