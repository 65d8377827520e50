"""`QCar`: throttle and steering out, encoder, IMU and battery in, with immediate or task-based reading."""

import math
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from qcar_twin.onboard.car import COUNTS, Sample
from qcar_twin.onboard.rig import HANDED_OUT, READ_TIME, Rig
from qcar_twin.vehicle.vehicle import GRAVITY

MOST_STEERING = 0.6  # rad, beyond which the car's own electronics clip
_IMMEDIATE, _TASK = 0, 1
_BUFFERED = 2.0  # s of samples that a task keeps for whoever reads too slowly


class QCar:
  """The car.

  Args:
    readMode: 0 reads at once; 1 hands out the samples of a task, one after the other, and waits for the next one.
    frequency: of the task, Hz.
    pwmLimit: largest duty, either way.
    steeringBias: added to every steering command, rad.

  Attributes:
    motorTach: speed by the encoder, m/s.  motorEncoder: counts since the start, (1,).
    gyroscope: x, y, z, rad/s; the simulated cars turn about z alone.
    accelerometer: x, y, z, m/s^2, z is gravity.
    batteryVoltage: V.  motorCurrent: A, from the motor's law.
  """

  rig: ClassVar[Rig]
  ENCODER_COUNTS_PER_REV = COUNTS / 4

  def __init__(
    self,
    readMode: int = _IMMEDIATE,
    frequency: float = 500,
    pwmLimit: float = 0.3,
    steeringBias: float = 0,
    hilPort: int = 18960,
  ):
    if readMode not in (_IMMEDIATE, _TASK):
      raise ValueError(f"QCar: readMode is 0 (at once) or 1 (a task), not {readMode!r}")
    if not 0 < frequency <= 10_000 or not 0 <= pwmLimit <= 1:
      raise ValueError(f"QCar: frequency is in Hz and pwmLimit a duty up to 1, not {frequency!r} and {pwmLimit!r}")
    self.readMode, self.frequency, self.pwmLimit, self.steeringBias = readMode, frequency, pwmLimit, steeringBias
    vehicle, self._next, self._open = self.rig.car.vehicle, 0, True
    self.hardware, self.carType, self._begun = True, 1, self.rig.clock.now
    self.WHEEL_RADIUS, self.WHEEL_BASE, self.WHEEL_TRACK = vehicle.wheel_radius, vehicle.wheelbase, vehicle.track_width
    self.PIN_TO_SPUR_RATIO = vehicle.gear_ratio
    self.CPS_TO_MPS = math.tau / COUNTS * vehicle.gear_ratio * vehicle.wheel_radius
    self.motorTach, self.motorCurrent, self.batteryVoltage = 0.0, 0.0, vehicle.supply_voltage
    self.motorEncoder: NDArray[np.int32] = np.zeros(1, dtype=np.int32)
    self.gyroscope, self.accelerometer = np.zeros(3), np.zeros(3)
    self.LEDs = np.zeros(8)
    self.rig.opened += 1

  def read(self) -> None:
    """Update what the sensors say."""
    clock = self.rig.clock
    if not self._open:
      return
    self.rig.reads += 1
    if self.readMode == _IMMEDIATE:
      clock.sleep_until(clock.now + READ_TIME)
      self._show(self.rig.car.sample(clock.now))
      return
    last = math.floor((clock.now - self._begun) * self.frequency + 1e-6)  # sample of the task that came last
    self._next = max(self._next, last - int(_BUFFERED * self.frequency) + 1)
    time = self._begun + self._next / self.frequency
    self._next += 1
    clock.sleep_until(max(time + HANDED_OUT, clock.now))
    self.rig.oldest = max(self.rig.oldest, clock.now - time)
    self._show(self.rig.car.sample(time))

  def write(self, throttle: float, steering: float, LEDs: Any = None) -> None:
    """Command a duty and a steering angle, rad, left positive; both are clipped."""
    throttle, steering = _number("throttle", throttle), _number("steering", steering)
    if not self._open:
      return
    self.rig.writes += 1
    if LEDs is not None:
      self.LEDs = np.array(LEDs, dtype=float)
    vehicle = self.rig.car.vehicle
    duty = min(max(throttle, -self.pwmLimit), self.pwmLimit)
    drive = duty if vehicle.drive == "duty" else duty * vehicle.supply_voltage
    angle = min(max(steering, -MOST_STEERING), MOST_STEERING) + self.steeringBias
    self.rig.car.tell(self.rig.clock.now, drive, angle)

  def read_write_std(self, throttle: float, steering: float, LEDs: Any = None) -> None:
    """Write, then read."""
    self.write(throttle, steering, LEDs)
    self.read()

  def terminate(self) -> None:
    """Bring the car to rest and let go of it."""
    if self._open:
      self.write(0.0, 0.0)
      self._open = False

  def _show(self, sample: Sample) -> None:
    vehicle = self.rig.car.vehicle
    self.motorTach = sample.motor_speed * vehicle.gear_ratio * vehicle.wheel_radius
    self.motorEncoder = np.array([sample.counts], dtype=np.int32)
    self.gyroscope = np.array([0.0, 0.0, sample.yaw_rate])
    self.accelerometer = np.array([sample.accel_x, sample.accel_y, GRAVITY])
    self.batteryVoltage = vehicle.supply_voltage
    constant = vehicle.motor_damping / vehicle.torque_per_volt  # K of K^2 / R and K / R
    self.motorCurrent = (sample.voltage - constant * sample.motor_speed) * vehicle.torque_per_volt / constant

  def __enter__(self) -> "QCar":
    return self

  def __exit__(self, *_: object) -> None:
    self.terminate()


def _number(name: str, value: Any) -> float:
  """A finite number; arrays of one are what a script's arithmetic easily makes of one."""
  if isinstance(value, (float, int)) and math.isfinite(value):
    return float(value)
  values = np.asarray(value, dtype=float)
  if values.size != 1 or not np.isfinite(values).all():
    raise ValueError(f"QCar.write: {name} must be one finite number, not {value!r:.80}")
  return float(values.reshape(()))
