"""One drawn car: masses, lengths and joints about those published of MIT's 1:10 RACECAR.

Lengths, masses and inertias are those of `racecar.urdf` (MIT racecar_gazebo, also in pybullet_data): a chassis of 4 kg
with small parts on it, two steering hinges, and four wheels. What that file lacks is stated physics.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

GRAVITY = 9.81
BASE, HALF_TRACK, RADIUS, HEIGHT = 0.325, 0.1, 0.05, 0.05  # m: hinges, wheels, the chassis' frame
CHASSIS, WHEEL, HINGE = 4.33, 0.34055, 0.1  # kg: 4 kg, two frames of 0.1 kg and a lidar of 0.13 kg; each wheel, hinge
CHASSIS_INERTIA = (0.010609, 0.050409, 0.05865)  # kg m^2, roll, pitch, yaw of the 4 kg about their own centre
WHEEL_SPIN, WHEEL_ACROSS, HINGE_INERTIA = 4.1226e-4, 2.6046e-4, 4e-6  # kg m^2, each
SAG = (0.0015, 0.003)  # m, under the static load: foam tyres on stiffened springs bounce at 9 to 13 Hz
BOUNCE_DAMPING = (0.2, 0.4)  # damping ratio of that
GRIP = 0.8  # dry friction of rubber on a smooth floor; Exudyn's examples of rolling discs have 0.4 to 0.8
ZONE = 0.1  # m/s of sliding from which on friction is full, as in Exudyn's example of a car (`carRollingDiscTest`)
RESISTANCE = 0.012  # friction of all wheels over the weight
FADING = 0.02  # 1/s: deceleration per speed of the bearings' viscous friction
TORQUE_PER_AMP = (0.045, 0.065)  # N m/A at the wheels: 6 to 12 A then give 1 to 2 m/s^2
SERVO = (0.02, 0.035)  # s, lag of the wheels behind the command at low frequencies
SERVO_DAMPING = (0.8, 1.1)  # damping ratio of its position loop
SERVO_RATE = 20.0  # rad/s: its fastest, 0.05 s for 60 deg; no step of a session asks for more
TRAVEL = 0.5  # rad: the wheels' mean angle at the stops
MOST_HELD = 4500.0  # 1/s of a wheel's spin; the integration is stable up to 5020
SPREAD = {"chassis": 0.12, "inertia": 0.12, "height": 0.2, "radius": 0.04, "spin": 0.1, "grip": 0.15, "zone": 0.15}
"""Largest relative departure from these figures, uniform."""


@dataclass
class Numbers:
  """Parameters that effects change. Lengths in m, masses in kg, inertias in kg m^2.

  Attributes:
    mass: of the whole car.  ahead, behind: front and rear axle from its centre of gravity.  height: of that.
    roll_inertia, pitch_inertia, yaw_inertia: of the chassis about its own centre.
    wheel_spin: inertia of a wheel about its axle.
    stiffness [N/m], damping [N s/m]: of each wheel's contact, upwards.
    grip_left, grip_right: friction coefficients of the wheels of a side.
    zone_front, zone_rear: speed of sliding from which on friction is full, m/s.
    per_ampere: torque at the wheels, N m/A.  left_share: of it at the left rear wheel.
    dry [N m], fading [N m s/rad]: friction of each wheel's bearing.  dragging: more of it at the right rear wheel, N m.
    preload: friction between the rear wheels, N m.  drag: kg/m, of the square of the speed, at the centre of gravity.
    servo: lag at low frequencies, s.  servo_damping: ratio.  servo_rate: rad/s.  travel: rad.
    toe: each front wheel's angle inwards, rad.  bent: the right rear wheel's angle to the left, rad.
  """

  mass: float
  ahead: float
  behind: float
  height: float
  radius: float
  roll_inertia: float
  pitch_inertia: float
  yaw_inertia: float
  wheel_spin: float
  stiffness: float
  damping: float
  grip_left: float
  grip_right: float
  zone_front: float
  zone_rear: float
  per_ampere: float
  dry: float
  fading: float
  servo: float
  servo_damping: float
  servo_rate: float = SERVO_RATE
  travel: float = TRAVEL
  left_share: float = 0.5
  dragging: float = 0.0
  preload: float = 0.0
  drag: float = 0.0
  toe: float = 0.0
  bent: float = 0.0

  def copied(self) -> Numbers:
    """Other numbers of the same values."""
    return copy.copy(self)

  @property
  def hubs(self) -> list[tuple[float, float]]:
    """Places of the wheels from the centre of gravity, front left, front right, rear left, rear right."""
    return [(x, y) for x in (self.ahead, -self.behind) for y in (HALF_TRACK, -HALF_TRACK)]

  @property
  def chassis(self) -> tuple[float, np.ndarray]:
    """Mass of the car without wheels and hinges, and its centre (3,) from the whole car's."""
    mass = self.mass - 4.0 * WHEEL - 2.0 * HINGE
    x = -(2.0 * (WHEEL + HINGE) * self.ahead - 2.0 * WHEEL * self.behind) / mass
    z = -(4.0 * WHEEL + 2.0 * HINGE) * (self.radius - self.height) / mass
    return mass, np.array([x, 0.0, z])

  @property
  def whole_yaw_inertia(self) -> float:
    """Of the whole car about the vertical through its centre of gravity, by Steiner's theorem."""
    mass, place = self.chassis
    hinges = sum(HINGE_INERTIA + HINGE * (x**2 + y**2) for x, y in self.hubs[:2])
    wheels = sum(WHEEL_ACROSS + WHEEL * (x**2 + y**2) for x, y in self.hubs)
    return self.yaw_inertia + mass * float(place[0]) ** 2 + hinges + wheels

  @property
  def held(self) -> float:
    """How fast the floor brings a wheel's spin to what rolls at most, 1/s, under the static load."""
    load = 0.5 * GRAVITY * self.mass * max(self.ahead, self.behind) / (self.ahead + self.behind)
    grip = max(self.grip_left, self.grip_right) / min(self.zone_front, self.zone_rear)
    return 2.0 * grip * load * self.radius**2 / self.wheel_spin

  @property
  def bounce(self) -> tuple[float, float]:
    """Frequency [Hz] and damping ratio of the car on its four contacts."""
    return sqrt(4.0 * self.stiffness / self.mass) / (2.0 * pi), self.damping / sqrt(self.stiffness * self.mass)

  def check(self) -> None:
    """Raises ValueError where such a car is impossible."""
    positive = ("ahead", "behind", "height", "radius", "roll_inertia", "pitch_inertia", "yaw_inertia", "wheel_spin",
                "stiffness", "grip_left", "grip_right", "zone_front", "zone_rear", "per_ampere", "servo", "servo_rate",
                "travel")  # fmt: skip
    wrong = [name for name in positive if not getattr(self, name) > 0.0]
    none_below = ("damping", "dry", "fading", "dragging", "preload", "drag", "servo_damping")
    wrong += [name for name in none_below if not getattr(self, name) >= 0.0]
    wrong += ["mass"] * (not self.chassis[0] > 0.0) + ["left_share"] * (not 0.0 <= self.left_share <= 1.0)
    wrong += [name for name in ("toe", "bent") if not abs(getattr(self, name)) < 0.5]
    wrong += ["travel"] * (not self.travel < 0.9)  # beyond it the inner wheel would stand across
    if not wrong and self.held > MOST_HELD:
      wrong = ["zone_front", "zone_rear", "wheel_spin"]
    if wrong:
      raise ValueError(f"no such car of Exudyn: {', '.join(f'{name} {getattr(self, name):g}' for name in wrong)}")


def draw(rng: np.random.Generator) -> Numbers:
  """A car about the published one, the same to both sides, its axles' contacts nearly alike."""
  drawn = lambda low, high: float(rng.uniform(low, high))
  part = {name: drawn(1.0 - spread, 1.0 + spread) for name, spread in SPREAD.items()}
  mass, radius = CHASSIS * part["chassis"] + 4.0 * WHEEL + 2.0 * HINGE, RADIUS * part["radius"]
  behind = BASE * drawn(0.45, 0.52)
  roll, pitch, yaw = (part["chassis"] * part["inertia"] * value for value in CHASSIS_INERTIA)
  stiffness = 0.25 * mass * GRAVITY / drawn(*SAG)
  zone, grip = ZONE * part["zone"], GRIP * part["grip"]
  return Numbers(
    mass=mass, ahead=BASE - behind, behind=behind, height=HEIGHT * part["height"], radius=radius,
    roll_inertia=roll, pitch_inertia=pitch, yaw_inertia=yaw, wheel_spin=WHEEL_SPIN * part["spin"],
    stiffness=stiffness, damping=drawn(*BOUNCE_DAMPING) * sqrt(stiffness * mass),
    grip_left=grip, grip_right=grip, zone_front=zone * drawn(1.0, 1.1), zone_rear=zone,
    per_ampere=drawn(*TORQUE_PER_AMP),
    dry=0.25 * RESISTANCE * drawn(0.8, 1.2) * mass * GRAVITY * radius,
    fading=0.25 * FADING * drawn(0.8, 1.2) * mass * radius**2,
    servo=drawn(*SERVO), servo_damping=drawn(*SERVO_DAMPING),
  )  # fmt: skip
