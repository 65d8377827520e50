"""One drawn car: the published parameters of a BMW 320i at a size, and what the package has no parameter for."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import numpy as np

from ..generator import load_package
from .scale import to_size

GRAVITY = 9.81
PUBLISHED_BASE, PUBLISHED_MASS = 2.5789128, 1093.2952334674046  # m, kg: of the package's vehicle 2
SPREAD = {"m": 0.12, "I_z": 0.12, "h_s": 0.2, "R_w": 0.04, "K_s": 0.2, "K_d": 0.2}
"""Largest relative departure from the published car, uniform."""
SHIFTS = ("p_hy1", "p_hy3", "p_vy1", "p_vy3")
"""Shifts of the tyres' side force. In the package they change sign with the wheel's camber, so that 4 % of a wheel's
load jumps from one side to the other within a step: no tyre does that, and they are 0 here."""
ONE_SIDED = ("r_hx1", "r_by3", "r_vy1")
"""What is of one side in the tyres' combined slip: Pacejka 2012, ch. 4.3. A car has its left tyres mirrored on the
right. The package has the same on both sides, so that its car steers by its drive, to a side: they are 0 here."""
RESISTANCE = 0.012  # rolling resistance over weight
FADING = 0.025  # 1/s at 1:10: deceleration per speed of the driveline's viscous friction


@dataclass(frozen=True)
class Size:
  """One size of the car.

  Attributes:
    base: wheelbase, m.  mass: kg.
    per_ampere: torque at the wheels per motor current, N m/A, drawn between these.
    servo: lag of the steering at low frequencies, s, drawn between these.
    servo_rate: its fastest, rad/s.
    steps: of the integration in a control period.
  """

  base: float
  mass: float
  per_ampere: tuple[float, float]
  servo: tuple[float, float]
  servo_rate: float
  steps: int

  @property
  def length(self) -> float:
    """Over that of the car at 1:10."""
    return self.base / TENTH.base

  @property
  def amperes(self) -> float:
    """Current for an acceleration, over that of the car at 1:10."""
    own, tenth = float(np.mean(self.per_ampere)), float(np.mean(TENTH.per_ampere))
    return self.mass * self.base / own / (TENTH.mass * TENTH.base / tenth)


TENTH = Size(0.1 * PUBLISHED_BASE, 2.7, (0.020, 0.030), (0.02, 0.035), 8.0, 20)
FULL = Size(PUBLISHED_BASE, PUBLISHED_MASS, (2.5, 3.5), (0.05, 0.09), 2.5, 5)


@dataclass
class Numbers:
  """Parameters that effects change.

  Attributes:
    car: the package's own.
    per_ampere: torque at the driven wheels, N m/A.
    servo: time constant of the steering's position loop, s.
    dry: Coulomb friction of the driveline at the wheels, N m.  fading: its viscous friction there, N m s/rad.
    drag: kg/m, of the square of the speed, at the driven wheels.
  """

  car: Any
  per_ampere: float
  servo: float
  dry: float
  fading: float
  drag: float = 0.0

  def copied(self) -> Numbers:
    """Other numbers of the same values."""
    return copy.deepcopy(self)

  @property
  def height(self) -> float:
    """Of the centre of gravity of the whole car, m; the package's `h_s` is that of the sprung mass."""
    p = self.car
    return (p.m_s * p.h_s + (p.m_uf + p.m_ur) * p.R_w) / p.m

  @property
  def bounce(self) -> tuple[float, float]:
    """Frequency [Hz] and damping ratio of the sprung mass on its four springs."""
    p = self.car
    stiffness, damping = 2.0 * (p.K_sf + p.K_sr), 2.0 * (p.K_sdf + p.K_sdr)
    return sqrt(stiffness / p.m_s) / (2.0 * pi), damping / (2.0 * sqrt(stiffness * p.m_s))


def draw(size: Size, rng: np.random.Generator) -> Numbers:
  """A car about the published one: rear drive, brakes by its motor alone, tyres the same to both sides.

  Raises MissingGenerator where the package is not installed.
  """
  p = load_package("vehiclemodels.parameters_vehicle2", "commonroad-vehicle-models").parameters_vehicle2()
  to_size(p, size.base, size.mass)
  drawn = lambda low, high: float(rng.uniform(low, high))  # a NumPy scalar would double the time of a run
  part = {name: drawn(1.0 - spread, 1.0 + spread) for name, spread in SPREAD.items()}
  for name in ("m", "m_s", "m_uf", "m_ur", "I_Phi_s", "I_y_s"):
    setattr(p, name, getattr(p, name) * part["m"])
  for name, key in (
    ("I_z", "I_z"), ("h_s", "h_s"), ("h_cg", "h_s"), ("R_w", "R_w"), ("K_sf", "K_s"), ("K_sr", "K_s"), ("K_tsf", "K_s"),
    ("K_tsr", "K_s"), ("K_sdf", "K_d"), ("K_sdr", "K_d"),
  ):  # fmt: skip
    setattr(p, name, getattr(p, name) * part[key])
  p.a = size.base * drawn(0.44, 0.52)
  p.b = size.base - p.a
  p.T_sb = p.T_se = 0.0
  grip, stiff = drawn(0.85, 1.1), drawn(0.85, 1.15)
  for name in ("p_dx1", "p_dy1"):
    setattr(p.tire, name, getattr(p.tire, name) * grip)
  for name in ("p_kx1", "p_ky1"):
    setattr(p.tire, name, getattr(p.tire, name) * stiff)
  for name in (*SHIFTS, *ONE_SIDED):
    setattr(p.tire, name, 0.0)
  p.steering.v_max, p.steering.v_min = size.servo_rate, -size.servo_rate
  weight = p.m * GRAVITY
  return Numbers(
    p,
    per_ampere=drawn(*size.per_ampere),
    servo=drawn(*size.servo),
    dry=RESISTANCE * drawn(0.8, 1.2) * weight * p.R_w,
    fading=FADING / sqrt(size.length) * drawn(0.8, 1.2) * p.m * p.R_w**2,
  )
