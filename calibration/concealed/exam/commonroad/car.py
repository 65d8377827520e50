"""The multi-body car as a generator: at 1:10 (`commonroad`) and at full size (`commonroad_full`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...laboratory.manoeuvres import Manoeuvre
from ..effects import Concealed, Nuisance, altered
from ..owner import reading, readings
from ..sensing import NOISE
from .driver import RoadDriver
from .effects import effects_of_size, nuisances_of
from .numbers import FULL, TENTH, Size, draw
from .plant import CommonroadPlant
from .runs import rolling

GEAR = 0.1  # wheel speed / motor speed, not in the package, which turns its wheels directly
ANSWER = 3.0  # 1/s at 1:10, of the driver's feedback on speed
PARALLEL_STD = 0.1  # of the share of Ackermann's angle, by a ruler between the front wheels at lock
SERVO_STD = 0.05  # of the steering's lag, filmed


class CommonroadCar:
  """One drawn car at 1:10; attributes of `Generator`."""

  size: Size = TENTH
  design, drive_limit, drive_step, channel = "rolling", 40.0, 1e-2, "motor_current"
  noise: Mapping[str, float] = NOISE
  driver = RoadDriver
  effects = effects_of_size(TENTH)

  def __init__(self, rng: np.random.Generator) -> None:
    """Raises MissingGenerator where the package is not installed."""
    self.numbers = draw(self.size, rng)

  def runs(self, rng: np.random.Generator) -> list[Manoeuvre]:
    """Manoeuvres of a rolling car: the package has no reverse, and another model below 0.1 m/s."""
    return rolling(rng, self.size.length, self.size.amperes)

  def plant(
    self, concealed: Sequence[Concealed] = (), moved: Sequence[tuple[Nuisance, float]] = (), later: bool = False
  ) -> CommonroadPlant:
    """A fresh car; the `Generator`'s arguments."""
    return CommonroadPlant(altered(self.numbers.copied(), concealed, moved, later), GEAR, self.size.steps)

  def bench(self, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """The steering's lag at low frequencies, read off filmed road wheels."""
    std = SERVO_STD * self.numbers.servo
    read = reading(self.numbers.servo, std, rng)
    return {"servo_time_constant": read}, {"servo_time_constant": std}

  def nuisances(self, std: Mapping[str, float]) -> dict[str, Nuisance]:
    """Numbers of the car that a recalibration may move."""
    return nuisances_of(dict(std), self.numbers)

  def measured(self, rng: np.random.Generator) -> tuple[dict[str, float | str], dict[str, float]]:
    """As read off scales, a ruler, a data sheet and a bounce; the wheelbase is exact, the linkage parallel."""
    p, (bounce, damping) = self.numbers.car, self.numbers.bounce
    true = {
      "mass": p.m, "yaw_inertia": p.I_z, "cg_to_front": p.a, "cg_to_rear": p.b, "track_width": 0.5 * (p.T_f + p.T_r),
      "cg_height": self.numbers.height, "wheel_radius": p.R_w, "motor_constant": self.numbers.per_ampere * GEAR,
      "suspension_frequency": bounce, "suspension_damping_ratio": damping,
    }  # fmt: skip
    read, std = readings(true, rng)
    known = {
      "layout": "rear",
      "differential": "open",
      "drive": "current",
      "gear_ratio": GEAR,
      "max_steering": p.steering.max,
    }
    known |= {"ackermann_fraction": 0.0, "max_current": self.drive_limit}
    return read | known, std | {"ackermann_fraction": PARALLEL_STD}

  def drive_line(self) -> tuple[float, float, float]:
    """Currents [A] from the losses and the mass."""
    n, p = self.numbers, self.numbers.car
    return (
      n.fading / (p.R_w * n.per_ampere),
      n.dry / n.per_ampere,
      ANSWER / np.sqrt(self.size.length) * p.m * p.R_w / n.per_ampere,
    )

  def described(self) -> dict[str, float | str]:
    """The package's parameters by its names, and the wrapper's."""
    n = self.numbers
    own = {name: value for name, value in vars(n).items() if name != "car"}
    return {"generator": "commonroad-vehicle-models", "parameters": "vehicle 2"} | own | _flat(n.car)


class CommonroadFullCar(CommonroadCar):
  """One drawn car at full size: 1.1 t, the same currents' accelerations, a localisation by satellites."""

  size = FULL
  drive_limit, drive_step = 390.0, 0.1
  noise: Mapping[str, float] = NOISE | {"pose": 0.01}
  effects = effects_of_size(FULL)


def _flat(owner: object, before: str = "") -> dict[str, float | str]:
  """Numbers of a part, and of its parts by their names behind a point."""
  out: dict[str, float | str] = {}
  for name, value in vars(owner).items():
    if isinstance(value, (int, float)):
      out[before + name] = float(value)
    elif hasattr(value, "__dict__"):
      out |= _flat(value, f"{before}{name}.")
  return out
