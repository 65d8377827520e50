"""How far one car's single track may be believed: its axle forces against gyro and accelerometer.

Beyond the tyres' linear range the single track turns and slides otherwise than the car. What the gyro says
against its prediction, nu over a period h, is an unexplained yaw moment
  M = I nu (1 / h + c2 / (I |v|)),  c2 = C_f L_f^2 + C_r L_r^2,
(the second part undoes that the prediction is stepped implicitly), that is an axle's force wrong by M / L and its slip
angle by M / (L C). What the accelerometer says against it, e, is a force m e that both axles have not: a slip angle of
m e / (C_f + C_r). Sideslip is as uncertain as both make it. Where less lateral acceleration is felt or steered than any
floor holds, tyres do not give way, and are wrong by no more than their slip angle; the rest is not theirs. Where more
is, they may be wrong by as much as would pass unseen, half of their linear slip angle: a softer tyre pushes as hard.

A car slides where half of its tyres' linear slip angle is not explained, or where it is pushed otherwise than they push
by twice what an accelerometer may be wrong. It is the slip angle of the push that is felt: what is steered for beyond
the floor's grip no tyre gives, and it excuses nothing. Tyres then say nothing of sideslip and yaw rate, nor do the
wheels, which spin or lock, of the speed. Accelerometer and gyro lead the car, as in inertial navigation:
  v' = a_x cos beta + a_y sin beta,  beta' = (a_y cos beta - a_x sin beta) / v - r
(Piyabongkarn, Rajamani, Grogg and Lew, IEEE Trans. Control Systems Technology 17(3), 2009). No sensor is accused by any
of it.
"""

import copy
import dataclasses
import math

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.models import STANDSTILL

MEMORY = 0.1  # s over which what is unexplained is averaged: the interval of a lidar that may correct it
LEANING = 0.5  # m/s^2, by which an accelerometer on a rolling, pitching car may be wrong for a while
REFUSALS = 3  # gyro samples in a row beyond the filter's gate, on one side, each 1e-4 likely by chance
LEAST_GRIP = 0.2 * 9.81  # m/s^2: prior, no floor that a car is driven on has less friction than 0.2
LOST = 0.5  # of the linear slip angle, which is not explained where a tyre is past its knee
COURSE = 0.5  # rad, by which an accelerometer may mistake the course of a car and still lead it: a linear error


@dataclasses.dataclass(slots=True)
class ModelWatch:
  """One car's single track.

  Attributes:
    turning: unexplained by the single track, slow mean, rad/s per period.  pushing: m/s^2, slow mean.
    felt: lateral acceleration, m/s^2, slow mean; zero without an accelerometer.  heard: whether there is one.
    refusals: gyro samples in a row beyond the gate, by their sign.  agreements: within it, in a row.
    refuted: whether the gyro is used against it.
    gives: whether more is asked of the tyres than any floor is sure to hold.
    wrong: slip angle, rad, that the axles may be wrong by.  sliding: whether the tyres have given way.
    risked: rad that a gyro used against the model has turned the yaw since the last fix.
  """

  turning: float = 0.0
  pushing: float = 0.0
  felt: float = 0.0
  heard: bool = False
  refusals: int = 0
  agreements: int = 0
  refuted: bool = False
  gives: bool = False
  wrong: float = 0.0
  sliding: bool = False
  risked: float = 0.0

  def copy(self) -> "ModelWatch":
    """An independent copy."""
    return copy.copy(self)

  def judge(self, innovation: float, fits: bool, period: float) -> None:
    """Take the gyro's rate less the predicted one, rad/s, and whether it lies within the filter's gate.

    What persists is no spike: the gyro has refuted the single track, until it agrees with it for a while.
    """
    if fits:
      self.refusals, self.agreements = 0, self.agreements + 1
    else:
      again = abs(self.refusals) + 1 if self.refusals * innovation > 0.0 else 1
      self.refusals, self.agreements = int(math.copysign(again, innovation)), 0
    refuted = self.refuted and self.agreements * period < MEMORY
    self.refuted = refuted or abs(self.refusals) >= REFUSALS
    if fits or self.refuted:
      self.turning += period / MEMORY * (innovation - self.turning)
    if not fits and self.refuted:
      self.risked += abs(innovation) * period

  def feel(self, acceleration: float, expected: float, period: float) -> None:
    """Take the lateral acceleration, m/s^2, NaN for none, and what the single track expects."""
    self.heard = math.isfinite(acceleration)
    self.felt += period / MEMORY * ((acceleration if self.heard else 0.0) - self.felt)
    self.pushing += period / MEMORY * ((acceleration - expected if self.heard else 0.0) - self.pushing)

  def weigh(self, speed: float, steering: float, car: SingleTrackCar, period: float) -> None:
    """Settle `wrong` and `sliding` at a speed, m/s, and an angle of the road wheels, rad."""
    front, rear = float(car.cornering_stiffness_front), float(car.cornering_stiffness_rear)
    ahead, behind = float(car.cg_to_front), float(car.cg_to_rear)
    mass, base, size = float(car.mass), ahead + behind, math.hypot(speed, STANDSTILL)
    turn = front * ahead**2 + rear * behind**2
    moment = self.turning * (float(car.yaw_inertia) / period + turn / size)
    force = mass * max(0.0, abs(self.pushing) - LEANING)
    wrong = math.hypot(moment / (base * min(front, rear)), force / (front + rear))
    asked = max(abs(steering) * size**2 / base, abs(self.felt))
    soft = mass * max(behind / front, ahead / rear) / base  # rad of linear slip angle for each m/s^2
    self.gives = asked >= LEAST_GRIP
    self.wrong = max(wrong, LOST * soft * asked) if self.gives else min(wrong, soft * asked)
    leaning = LEANING * MEMORY / size  # rad by which the accelerometer may mistake the sideslip meanwhile
    slips = wrong > max(LOST * soft * abs(self.felt), leaning) or abs(self.pushing) > 2.0 * LEANING
    self.sliding = self.heard and self.gives and slips and leaning < COURSE

  def sideslip_noise(self, speed: float, car: SingleTrackCar, period: float, interval: float) -> float:
    """Variance, rad^2, of the sideslip in a period, so that it is as uncertain between fixes as it should be.

    Tyres make sideslip forget in m |v| / C; an error `wrong` that stays for an `interval`, s, moves the car as a faster
    one of sqrt(interval / 2) times its share does. Of a sliding car the accelerometer is wrong by LEANING / |v|.
    """
    size = math.hypot(speed, STANDSTILL)
    if self.sliding:
      return period * interval * (LEANING / size) ** 2
    total = float(car.cornering_stiffness_front) + float(car.cornering_stiffness_rear)
    forgets = float(car.mass) * size / total
    kept = 1.0 / (1.0 + period / forgets)
    return (1.0 - kept**2) * max(1.0, interval / (2.0 * forgets)) * self.wrong**2
