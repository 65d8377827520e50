"""What a controller of N simulated cars knows of them: the truth, or what its sensors and filter make of it."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.batch import FederatedBatch
from qcar_twin.estimation.estimate import BatchEstimate
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.kinematics import sideslip_angle
from qcar_twin.plant import signal_index
from qcar_twin.sensors.suite import Reading, SensorSuite

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Heard = tuple[Array, Array, Array | None, int]
SPEED, TURNING = 0, 1  # columns of the motion that the filter is given
POSE = slice(signal_index("pose_x"), signal_index("pose_yaw") + 1)  # columns of the signals
VELOCITY = slice(signal_index("velocity_x"), signal_index("velocity_y") + 1)
YAW_RATE, MOTOR_SPEED = signal_index("yaw_rate"), signal_index("motor_speed")


class Observer(Protocol):
  """Estimates of N cars, one per control period: `begin`, then `command` and `observe` in turn."""

  def begin(self, signals: Array, which: Mask | None = None) -> BatchEstimate:
    """Start (again) at signals (N, 10), all cars or those of a mask."""
    ...

  def command(self, commands: Array) -> None:
    """Voltage and steering command (N, 2) that act over the next period."""
    ...

  def observe(self, signals: Array) -> BatchEstimate:
    """Estimates after a period that ended with these signals, (N, 10)."""
    ...


class TrueObserver:
  """Sees the signals themselves."""

  def begin(self, signals: Array, which: Mask | None = None) -> BatchEstimate:
    """The truth has no memory: the same as `observe`."""
    return self.observe(signals)

  def command(self, commands: Array) -> None:
    """The truth needs no commands."""

  def observe(self, signals: Array) -> BatchEstimate:
    """The signals as an estimate without error."""
    velocity = signals[:, VELOCITY]
    count = len(signals)
    speed = np.hypot(*velocity.T) * np.where(velocity[:, 0] < 0.0, -1.0, 1.0)
    return BatchEstimate(
      signals[:, POSE].copy(),
      velocity.copy(),
      speed,
      sideslip_angle(velocity[:, 0], velocity[:, 1]),
      signals[:, YAW_RATE].copy(),
      np.zeros((count, 3)),
      np.asarray(np.isfinite(signals).all(axis=1)),
      np.zeros((count, 2)),
    )


class SensedObserver:
  """Sensors and the federated filter.

  Args:
    suite: sensors of N cars; the lidar's channel order is pose_x, pose_y, pose_yaw, pose_score.
    car: the identified model the filter predicts with.
    settings: of the filter.
    keep: whether to keep what was heard.
    watched: whether the sensors are watched for faults, as in the online filter.

  Attributes:
    heard: what the filter was given each period, when `keep` is set: speed and yaw rate (N, 2), accelerations
      (N, 2), a fix (N, 4) or None and its age in periods.
  """

  def __init__(
    self,
    suite: SensorSuite,
    car: SingleTrackCar,
    settings: FilterSettings | None = None,
    keep: bool = False,
    watched: bool = False,
  ):
    self.suite = suite
    self._rolling_radius = float(np.asarray(car.rolling_radius))
    self.heard: list[Heard] = []
    self._keep = keep
    settings = settings or FilterSettings()
    if abs(settings.period - suite.period) > 1e-9:
      raise ValueError(
        f"a filter of a period of {settings.period:g} s on sensors of {suite.period:g} s; give the filter's settings"
        " and the suite the plant's period"
      )
    oldest = round(settings.buffer / settings.period)
    self.filter = FederatedBatch(car, settings, suite.count, oldest=oldest, watched=watched)

  def begin(self, signals: Array, which: Mask | None = None) -> BatchEstimate:
    """The filter is given where the cars start, to a centimetre."""
    which = np.ones(self.suite.count, dtype=bool) if which is None else which
    self.suite.restart(which, signals)
    speed = signals[:, MOTOR_SPEED] * self._rolling_radius
    self.filter.start(signals[:, POSE], speed, std=0.01, which=which)
    return self.filter.estimate()

  def command(self, commands: Array) -> None:
    """Tell the filter what acts over the next period."""
    self.filter.command(commands)

  def observe(self, signals: Array) -> BatchEstimate:
    """Let the sensors measure and the filter go on by a period."""
    none = np.full((self.suite.count, 2), np.nan)
    motion, accel, fix, age = none, none.copy(), None, 0
    for reading in self.suite.measure(signals):
      if "pose_x" in reading.channels:
        fix, age = reading.values, reading.age
      motion, accel = self._take(reading, motion.copy(), accel)
    if self._keep:
      self.heard.append((motion, accel, fix, age))
    self.filter.advance(motion, accel, fix, age)
    return self.filter.estimate()

  def _take(self, reading: Reading, motion: Array, accel: Array) -> tuple[Array, Array]:
    """Encoder and IMU samples into the filter's columns; they must arrive in the period they were taken."""
    if reading.age and "pose_x" not in reading.channels:
      raise ValueError(f"{', '.join(reading.channels)} arrive {reading.age} periods late; only the lidar's pose may")
    for i, name in enumerate(reading.channels):
      if name == "motor_speed":
        motion[:, SPEED] = reading.values[:, i] * self._rolling_radius
      elif name == "yaw_rate":
        motion[:, TURNING] = reading.values[:, i]
    if "accel_x" in reading.channels:
      accel = reading.values[:, [reading.channels.index(name) for name in ("accel_x", "accel_y")]]
    return motion, accel
