"""How far one car's single track may be believed: its axle forces against gyro and accelerometer.

Beyond the tyres' linear range the single track turns otherwise than the car, and slides otherwise. What the gyro says
against its prediction, nu over a period h, is an unexplained yaw moment
  M = I nu (1 / h + c2 / (I |v|)),  c2 = C_f L_f^2 + C_r L_r^2,
(the second part undoes that the prediction is stepped implicitly), that is an axle's force wrong by M / L and its slip
angle by M / (L C). What the accelerometer says against it, e, is a force m e that both axles have not: a slip angle of
m e / (C_f + C_r). Sideslip is as uncertain as both make it, up to the slip angle that the lateral acceleration asks of a
linear tyre, the one that is felt or the one that is steered: a tyre that gives way pushes less, not the other way. What
is unexplained beyond it is not the tyres'. No sensor is accused by it.
"""

import copy
import dataclasses
import math

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.models import STANDSTILL

MEMORY = 0.1  # s over which what is unexplained is averaged: the interval of a lidar that may correct it
LEANING = 0.5  # m/s^2, by which an accelerometer on a rolling, pitching car may be wrong for a while
REFUSALS = 3  # gyro samples in a row beyond the filter's gate, on one side, each 1e-4 likely by chance


@dataclasses.dataclass(slots=True)
class ModelWatch:
  """One car's single track.

  Attributes:
    turning: unexplained by the single track, slow mean, rad/s per period.  pushing: m/s^2, slow mean.
    felt: lateral acceleration, m/s^2, slow mean; zero without an accelerometer.
    refusals: gyro samples in a row beyond the gate, by their sign.
    risked: rad that a gyro used against the model has turned the yaw since the last fix.
  """

  turning: float = 0.0
  pushing: float = 0.0
  felt: float = 0.0
  refusals: int = 0
  risked: float = 0.0

  def copy(self) -> "ModelWatch":
    """An independent copy."""
    return copy.copy(self)

  @property
  def doubted(self) -> bool:
    """Whether the gyro has refuted it: what persists is no spike."""
    return abs(self.refusals) >= REFUSALS

  def judge(self, innovation: float, fits: bool, period: float) -> None:
    """Take the gyro's rate less the predicted one, rad/s, and whether it lies within the filter's gate."""
    if fits:
      self.refusals = 0
    else:
      again = abs(self.refusals) + 1 if self.refusals * innovation > 0.0 else 1
      self.refusals = int(math.copysign(again, innovation))
    if fits or self.doubted:
      self.turning += period / MEMORY * (innovation - self.turning)
    if self.doubted:
      self.risked += abs(innovation) * period

  def feel(self, acceleration: float, expected: float, period: float) -> None:
    """Take the lateral acceleration, m/s^2, NaN for none, and what the single track expects."""
    known = math.isfinite(acceleration)
    self.felt += period / MEMORY * ((acceleration if known else 0.0) - self.felt)
    self.pushing += period / MEMORY * ((acceleration - expected if known else 0.0) - self.pushing)

  def slip(self, speed: float, steering: float, car: SingleTrackCar, period: float) -> float:
    """Slip angle that the axles may be wrong by, rad, at a speed, m/s, and an angle of the road wheels, rad."""
    front, rear = float(car.cornering_stiffness_front), float(car.cornering_stiffness_rear)
    ahead, behind = float(car.cg_to_front), float(car.cg_to_rear)
    mass, base, size = float(car.mass), ahead + behind, math.hypot(speed, STANDSTILL)
    turn = front * ahead**2 + rear * behind**2
    moment = self.turning * (float(car.yaw_inertia) / period + turn / size)
    force = mass * max(0.0, abs(self.pushing) - LEANING)
    wrong = math.hypot(moment / (base * min(front, rear)), force / (front + rear))
    asked = max(abs(steering) * size**2 / base, abs(self.felt))
    return min(wrong, mass * asked * max(behind / front, ahead / rear) / base)

  def sideslip_noise(self, speed: float, steering: float, car: SingleTrackCar, period: float, interval: float) -> float:
    """Variance, rad^2, to be added to the sideslip in a period so that it is as uncertain as `slip` between fixes.

    Sideslip forgets in m |v| / C; an error that stays for an `interval`, s, moves the car as a faster one of
    sqrt(interval / 2) times its share does.
    """
    total = float(car.cornering_stiffness_front) + float(car.cornering_stiffness_rear)
    forgets = float(car.mass) * math.hypot(speed, STANDSTILL) / total
    kept = 1.0 / (1.0 + period / forgets)
    return (1.0 - kept**2) * max(1.0, interval / (2.0 * forgets)) * self.slip(speed, steering, car, period) ** 2
