"""The rigid-body car as a generator: `exudyn`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...laboratory.designs import plan
from ...laboratory.driver import Driver
from ...laboratory.manoeuvres import Manoeuvre
from ..effects import Concealed, Nuisance
from ..generator import load_package
from ..sensing import NOISE
from .effects import EXUDYN_EFFECTS, exudyn_nuisances
from .machine import PACKAGE
from .numbers import HALF_TRACK, draw
from .plant import ExudynPlant

GEAR = 0.1  # wheel speed / motor speed: torques act on the wheels themselves
ANSWER = 3.0  # 1/s, of the driver's feedback on speed
STD = {
  "mass": 0.01, "yaw_inertia": 0.08, "cg_to_front": 0.01, "cg_to_rear": 0.01, "track_width": 0.005,
  "cg_height": 0.1, "wheel_radius": 0.006, "motor_constant": 0.03, "suspension_frequency": 0.05,
  "suspension_damping_ratio": 0.15,
}  # fmt: skip
"""Relative standard deviations of an owner's scale, ruler, data sheet, and bounce test."""
SERVO_STD = 0.0015  # s, of a lag that was filmed


class ExudynCar:
  """One drawn car; attributes of `Generator`."""

  design, drive_limit, drive_step, channel = "vesc_current", 40.0, 1e-2, "motor_current"
  noise: Mapping[str, float] = NOISE
  driver = Driver
  effects = EXUDYN_EFFECTS

  def __init__(self, rng: np.random.Generator) -> None:
    """Raises MissingGenerator where Exudyn is not installed."""
    self.version = str(load_package("exudyn", PACKAGE).__version__)
    self.numbers = draw(rng)

  def runs(self, rng: np.random.Generator) -> list[Manoeuvre]:
    """The laboratory's design for a current."""
    return plan(self.design, rng)

  def plant(
    self, concealed: Sequence[Concealed] = (), moved: Sequence[tuple[Nuisance, float]] = (), later: bool = False
  ) -> ExudynPlant:
    """A fresh car; the `Generator`'s arguments."""
    numbers = self.numbers.copied()
    for act, amount in [(n.act, size) for n, size in moved] + [(c.effect.act, c.size) for c in concealed]:
      act(numbers, amount, later)
    return ExudynPlant(numbers, GEAR)

  def bench(self, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """The servo's lag at low frequencies, read off road wheels filmed at some hundred frames a second."""
    read = self.numbers.servo + SERVO_STD * np.clip(rng.standard_normal(), -2.0, 2.0)
    return {"servo_time_constant": read}, {"servo_time_constant": SERVO_STD}

  def nuisances(self, std: Mapping[str, float]) -> dict[str, Nuisance]:
    """Numbers of the car that a recalibration may move."""
    return exudyn_nuisances(dict(std), self.numbers)

  def measured(self, rng: np.random.Generator) -> tuple[dict[str, float | str], dict[str, float]]:
    """As read off a scale, a ruler, a data sheet and a bounce; the wheelbase itself is exact."""
    n, (bounce, damping) = self.numbers, self.numbers.bounce
    true = {
      "mass": n.mass, "yaw_inertia": n.whole_yaw_inertia, "cg_to_front": n.ahead, "cg_to_rear": n.behind,
      "track_width": 2.0 * HALF_TRACK, "cg_height": n.height, "wheel_radius": n.radius,
      "motor_constant": n.per_ampere * GEAR, "suspension_frequency": bounce, "suspension_damping_ratio": damping,
    }  # fmt: skip
    std = {name: STD[name] * value for name, value in true.items()}
    read = {name: value + std[name] * np.clip(rng.standard_normal(), -2.0, 2.0) for name, value in true.items()}
    read["cg_to_rear"] = n.ahead + n.behind - read["cg_to_front"]
    known = {"layout": "rear", "drive": "current", "gear_ratio": GEAR, "max_steering": n.travel}
    return read | known | {"max_current": self.drive_limit}, std

  def drive_line(self) -> tuple[float, float, float]:
    """Currents [A] from the bearings' friction and the mass."""
    n = self.numbers
    return (
      4.0 * n.fading / (n.radius * n.per_ampere),
      4.0 * n.dry / n.per_ampere,
      ANSWER * n.mass * n.radius / n.per_ampere,
    )

  def described(self) -> dict[str, float | str]:
    """Every number of the car."""
    return {"generator": "exudyn", "version": self.version} | vars(self.numbers)
