"""The rigid-body car as a generator: `exudyn`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...laboratory.designs import plan
from ...laboratory.driver import Driver
from ...laboratory.manoeuvres import Manoeuvre
from ..effects import Concealed, Nuisance, altered
from ..generator import load_package
from ..owner import reading, readings
from ..sensing import NOISE
from .effects import EXUDYN_EFFECTS, exudyn_nuisances
from .machine import PACKAGE
from .numbers import HALF_TRACK, draw
from .plant import ExudynPlant

GEAR = 0.1  # wheel speed / motor speed: torques act on the wheels themselves
ANSWER = 3.0  # 1/s, of the driver's feedback on speed
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
    return ExudynPlant(altered(self.numbers.copied(), concealed, moved, later), GEAR)

  def bench(self, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """The servo's lag at low frequencies, read off road wheels filmed at some hundred frames a second."""
    read = reading(self.numbers.servo, SERVO_STD, rng)
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
    read, std = readings(true, rng)
    known = {"layout": "rear", "differential": "open", "drive": "current", "gear_ratio": GEAR, "max_steering": n.travel}
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
