"""Speed control: proportional-integral with friction compensation, from the identified drive model."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qcar_twin.bicycle.single_track import SingleTrackCar

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class SpeedGains:
  """u = friction sgn(target) + proportional e + integral of e, u the drive's command in its unit U: V of a voltage.

  Attributes:
    hold: command per speed that steady motion needs, U s/m: where the integrator starts on a moving car.
    friction: command that friction needs, U.
    proportional: U s/m.  integral: U/m.  limit: largest command, U.  unit: U; "-" of a duty.
  """

  hold: float
  friction: float
  proportional: float
  integral: float
  limit: float = 11.1
  unit: str = "V"

  @classmethod
  def design(
    cls, car: SingleTrackCar, response_time: float = 0.3, limit: float = 11.1, unit: str = "V"
  ) -> "SpeedGains":
    """Pole-cancelling gains: the speed follows its reference like a first-order lag of `response_time` s.

    With dv/dt = b V - P2 v - friction, b = G R_w P1: proportional = 1 / (b response_time), integral = P2 times that
    (Skogestad, Simple analytic rules for model reduction and PID controller tuning, J. Process Control 13, 2003).
    """
    gain = float(car.rolling_radius * np.asarray(car.drive_gain))  # m/s^2 per U
    proportional = 1.0 / (gain * response_time)
    damping = float(np.asarray(car.drive_damping))
    friction = float(np.asarray(car.drive_friction) / np.asarray(car.drive_gain))
    return cls(damping / gain, friction, proportional, damping * proportional, limit, unit)

  def require(self, speed: ArrayLike) -> None:
    """Raises ValueError for a speed, m/s, that the identified car does not hold at the largest command."""
    wanted = float(np.max(np.abs(speed)))
    if (needed := self.friction + self.hold * wanted) > self.limit:
      takes = f"a duty of {needed:.3g} of" if self.unit == "-" else f"{needed:.3g} {self.unit} of"
      most = f"{self.limit:g} {self.unit}".removesuffix(" -")
      raise ValueError(f"speed {wanted:g} m/s: it takes {takes} {most}; ask for less")


class SpeedController:
  """The PI controller of N cars with its integrators.

  Args:
    gains: from SpeedGains.design.
    speed: of the cars when it takes over, m/s, (N,).
  """

  def __init__(self, gains: SpeedGains, speed: Array):
    self.gains = gains
    self._integral = gains.hold * np.asarray(speed, dtype=np.float64)

  def restart(self, which: NDArray[np.bool_], speed: Array) -> None:
    """Take over some cars again at speeds (N,), m/s."""
    self._integral = np.where(which, self.gains.hold * speed, self._integral)

  def voltage(self, speed: Array, target: ArrayLike, period: float) -> Array:
    """The drive's command, U, (N,), for measured and wanted speeds, m/s. The integrator stands still at the limit, and
    where no speed was measured (NaN), which counts as the wanted one."""
    gains, target = self.gains, np.asarray(target, dtype=np.float64)
    error = np.where(np.isfinite(speed), target - speed, 0.0)
    wanted = gains.friction * np.sign(target) + gains.proportional * error + self._integral
    voltage = np.clip(wanted, -gains.limit, gains.limit)
    free = (voltage == wanted) | (np.sign(error) != np.sign(wanted))
    self._integral = self._integral + np.where(free, gains.integral * error * period, 0.0)
    return voltage
