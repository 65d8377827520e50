"""Numbers of the federated filter: noise, gates, limits, each with its unit and its reason."""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from qcar_twin.recordings.recording import Recording, nearest
from qcar_twin.sensors.noise import Standstill
from qcar_twin.sensors.score import ScoreVariance
from qcar_twin.vehicle.drive import FRONT_SHARE
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
MOTION_STATES = 6  # of EKF_BM: position, speed, yaw, sideslip, yaw rate
PRIORS = {"steering_gain": 0.1, "steering_offset": 0.03, "yaw_rate_bias": 0.02, "speed_scale": 0.05, "drive_scale": 0.2}
"""What EKF_BM may estimate beside its motion, with standard deviations nobody would bet against: a linkage measured to
a tenth and set to 2 degrees, a MEMS gyro that was switched on without standing still (rad/s), a wheel radius measured
to a twentieth, a motor known by its data sheet."""
ESTIMATED = ("steering_gain", "steering_offset", "yaw_rate_bias", "speed_scale")
"""Those of them that are worth a state: docs/results/estimation.md."""

NEVER_NEGATIVE = ("_std", "_lag", "_delay", "_timeout", "_limit", "_correlation")
POSITIVE = ("period", "buffer", "speed_std", "yaw_rate_std", "speed_scale", "drive_scale", "forgetting", "score_full")
KNOWN = {  # as they are, of a twin's parameters, and of the settings
  "steering_offset": "steering_offset",
  "gyro_bias": "yaw_rate_bias",
  "accel_bias_x": "accel_x_bias",
  "accel_bias_y": "accel_y_bias",
}


@dataclasses.dataclass(frozen=True)
class FilterSettings:
  """What the filters assume about noise, and when they stop believing.

  Attributes:
    period: of the prediction, s.
    walk_*: process noise densities, unit of the state per sqrt(s), of EKF_BM (position, speed, yaw,
      sideslip, yaw rate) and EKF_PM (its position and velocity).
    speed_std, yaw_rate_std, accel_std: of encoder m/s, gyro rad/s, accelerometer against the single track m/s^2.
    central: one filter instead of two: the lateral acceleration corrects EKF_BM as a measurement and
      EKF_PM is off. For comparison.
    position_variance, yaw_variance: of the lidar against its score, m^2 and rad^2.
    score: assumed where the lidar gives none, on a scale to 100.
    score_full: the lidar's best score; its scores are brought to a scale to 100 with it.
    lidar_correlation: time constant of the lidar's error, s; fixes are then counted as that much less
      informative, R (1 + a) / (1 - a) with a = exp(-interval / correlation). 0 for white errors.
    lidar_interval: between fixes, s; used by `lidar_correlation` alone.
    sharing: information sharing factors of the lidar for EKF_BM and EKF_PM. (1, 1) is the paper's: both
      use every fix with full weight and the fusion is over-confident; a sum of 1 is consistent.
    gate: probability of refusing a good measurement.
    imu_x, imu_y: lever arm of the IMU from the centre of gravity, m.
    accel_x_bias, accel_y_bias, yaw_rate_bias: known from standstill, m/s^2 and rad/s, subtracted.
    steering_lag: first-order time constant of the steering servo between command and angle, s; the paper has none.
    steering_gain, steering_offset: of the linkage, - and rad: the road wheels' angle is gain times command plus offset.
    speed_scale: what the encoder says over the speed of the car.  drive_scale: voltage that acts over the commanded.
    drive_delay, steering_delay: dead times of voltage and steering command, before the lag, s; rounded to periods.
    steering_gain_std, steering_offset_std, yaw_rate_bias_std, speed_scale_std, drive_scale_std: how well these are
      known. What has one above zero is a state of EKF_BM.
    forgetting: s in which such a number may change by its own standard deviation.
    front_drive_share: of the front axle in the speed the encoder sees. Steered wheels roll faster than the car,
      v / cos(steering angle): 0.5 for a motor between open differentials, 0 for rear drive and for the
      plain single track.
    buffer: how late a measurement may come, s.
    accel_timeout: without an accelerometer for this long EKF_PM is left out, s.
    lidar_timeout: without an accepted fix for this long the estimate is not valid, s.
    position_limit, yaw_limit: standard deviations beyond which the estimate is not valid, m and rad.
    risk: probability with which an error may be larger than the bound that is stated for it.
    lost_after: least number of refused fixes at one place after which the position is taken from the lidar afresh.
  """

  period: float = 0.01
  walk_position: float = 0.005
  walk_speed: float = 0.3
  walk_yaw: float = 0.01
  walk_sideslip: float = 0.15
  walk_yaw_rate: float = 2.0
  walk_point_position: float = 0.002
  walk_point_velocity: float = 0.1
  speed_std: float = 0.03
  yaw_rate_std: float = 0.02
  accel_std: float = 0.5
  central: bool = False
  position_variance: ScoreVariance = ScoreVariance.between(0.004, 0.04, 20.0, 2.0)
  yaw_variance: ScoreVariance = ScoreVariance.between(0.004, 0.04, 20.0, 2.0)
  score: float = 80.0
  score_full: float = 100.0
  lidar_correlation: float = 0.0
  lidar_interval: float = 0.1
  sharing: tuple[float, float] = (1.0, 1.0)
  gate: float = 1e-4
  imu_x: float = 0.0
  imu_y: float = 0.0
  accel_x_bias: float = 0.0
  accel_y_bias: float = 0.0
  yaw_rate_bias: float = 0.0
  steering_lag: float = 0.0
  steering_gain: float = 1.0
  steering_offset: float = 0.0
  speed_scale: float = 1.0
  drive_scale: float = 1.0
  drive_delay: float = 0.0
  steering_delay: float = 0.0
  steering_gain_std: float = 0.0
  steering_offset_std: float = 0.0
  yaw_rate_bias_std: float = 0.0
  speed_scale_std: float = 0.0
  drive_scale_std: float = 0.0
  forgetting: float = 600.0
  front_drive_share: float = 0.0
  buffer: float = 1.0
  accel_timeout: float = 0.25
  lidar_timeout: float = 5.0
  position_limit: float = 0.15
  yaw_limit: float = 0.3
  risk: float = 1e-3
  lost_after: int = 5

  def __post_init__(self) -> None:
    numbers = {name: value for name, value in vars(self).items() if isinstance(value, (int, float))}
    for name, value in numbers.items():
      if math.isnan(value):
        raise ValueError(f"FilterSettings.{name} is not a number; leave it out for {getattr(type(self), name)}")
      if name.startswith("walk_") or name.endswith(NEVER_NEGATIVE):
        if value < 0.0:
          raise ValueError(f"FilterSettings.{name} is {value:g}; it must not be negative")
      if name in POSITIVE and value <= 0.0:
        raise ValueError(f"FilterSettings.{name} is {value:g}; it must be positive")
    for name in ("gate", "risk"):
      if not 0.0 < numbers[name] < 1.0:
        raise ValueError(f"FilterSettings.{name} is {numbers[name]:g}; a probability lies between 0 and 1")
    if min(self.sharing) <= 0.0 or max(self.sharing) > 1.0:
      raise ValueError(f"information sharing factors must lie in (0, 1], got {self.sharing}")

  @classmethod
  def of_vehicle(cls, vehicle: Vehicle, **changes: Any) -> "FilterSettings":
    """Settings for a car: where its IMU is, and which of its wheels the encoder sees; `changes` by name.

    Raises:
      ValueError: a number that cannot be.
      TypeError: there is no such setting.
    """
    share = FRONT_SHARE[vehicle.layout]
    return cls(**{"imu_x": vehicle.imu_x, "imu_y": vehicle.imu_y, "front_drive_share": share, **changes})

  @cached_property
  def lidar_factor(self) -> float:
    """By how much a correlated lidar error is less informative than a white one of the same size."""
    if self.lidar_correlation <= 0.0:
      return 1.0
    a = math.exp(-self.lidar_interval / self.lidar_correlation)
    return (1.0 + a) / (1.0 - a)

  @cached_property
  def limits(self) -> tuple[float, float, float]:
    """NIS limits for one, two and three measured components."""
    first, second, third = (float(chi2.isf(self.gate, k)) for k in (1, 2, 3))
    return first, second, third

  @cached_property
  def reach(self) -> tuple[float, float]:
    """Standard deviations that bound a position (of its worst direction) and an angle, by `risk`."""
    return math.sqrt(float(chi2.isf(self.risk, 2))), math.sqrt(float(chi2.isf(self.risk, 1)))

  def with_scores_of(self, recordings: Iterable[Recording]) -> "FilterSettings":
    """These settings with the scale of the recordings' scores: to 1 when none exceeds it, else to 100."""
    scores = [r["pose_score"].value.max() for r in recordings if "pose_score" in r.streams]
    return dataclasses.replace(self, score_full=1.0 if scores and max(scores) <= 1.0 else 100.0)

  def estimating(self, *names: str) -> "FilterSettings":
    """These settings with numbers, of `PRIORS`, as states of EKF_BM, known as badly as stated there.

    Raises:
      ValueError: it estimates no such number, with the nearest one.
    """
    for name in names:
      if name not in PRIORS:
        raise ValueError(f"the filter cannot estimate '{name}'{nearest(name, PRIORS)}")
    return dataclasses.replace(self, **{f"{name}_std": PRIORS[name] for name in names})

  @cached_property
  def unknown(self) -> dict[str, float]:
    """Numbers that are states of EKF_BM, after those of its motion, with their standard deviations at the start."""
    known = {name: getattr(self, f"{name}_std") for name in PRIORS}
    return {name: std for name, std in known.items() if std > 0.0}

  @cached_property
  def rows(self) -> dict[str, int]:
    """Where in EKF_BM's state the unknown numbers are: what has to be added to what the settings say of them."""
    return {name: MOTION_STATES + i for i, name in enumerate(self.unknown)}

  @cached_property
  def delays(self) -> tuple[int, int]:
    """Of voltage and steering command, periods."""
    return round(self.drive_delay / self.period), round(self.steering_delay / self.period)

  def with_known(self, values: Mapping[str, float]) -> "FilterSettings":
    """These settings with what is known of steering, delays and sensors from a twin's parameters.

    The twin's lags of servo and steering add up; of the steering's dead time the part that is no whole period is
    counted as lag, the same phase at low frequency. The drive has no lag here: its dead time is taken as it is, and
    acts rounded to periods. A `command_delay` adds to either, down to none where it is negative: commands that act
    sooner than they were logged. A wheel larger by e makes the encoder say 1 / (1 + e) of the speed. All this replaces
    what the settings said, but for the IMU's lever arm [m]: the twin's is an error of theirs, and is added to it. What
    the twin does not have stays as it is.

    Args:
      values: parameters by name, as of `twin.parameters.named(theta)`.
    """
    changes: dict[str, Any] = {mine: values[name] for name, mine in KNOWN.items() if name in values}
    if "servo_time_constant" in values or "steering_lag" in values:
      changes["steering_lag"] = values.get("servo_time_constant", 0.0) + values.get("steering_lag", 0.0)
    if "steering_gain_error" in values:
      changes["steering_gain"] = 1.0 + values["steering_gain_error"]
    if "wheel_radius_error" in values:
      changes["speed_scale"] = 1.0 / (1.0 + values["wheel_radius_error"])
    for axis, name in (("imu_x", "imu_lever_arm_x"), ("imu_y", "imu_lever_arm_y")):
      if name in values:
        changes[axis] = getattr(self, axis) + values[name]
    late = lambda name: max(0.0, values.get(name, 0.0) + values.get("command_delay", 0.0))
    if "drive_delay" in values or "command_delay" in values:
      changes["drive_delay"] = late("drive_delay")
    if "steering_delay" in values or "command_delay" in values:
      whole = math.floor(late("steering_delay") / self.period + 1e-6) * self.period
      changes["steering_delay"] = whole
      lag = changes.get("steering_lag", self.steering_lag)
      changes["steering_lag"] = lag + max(0.0, late("steering_delay") - whole)
    return dataclasses.replace(self, **changes)

  def with_walks(self, factor: float) -> "FilterSettings":
    """These settings with all process noise densities times a factor."""
    walks = [f.name for f in dataclasses.fields(self) if f.name.startswith("walk_")]
    return dataclasses.replace(self, **{name: factor * getattr(self, name) for name in walks})

  def with_noise(self, noise: Mapping[str, Standstill], rolling_radius: float) -> "FilterSettings":
    """These settings with what a standstill recording tells of the sensors.

    Gyro, lidar and biases are taken over. An encoder at rest has no noise, so `speed_std` stays what slip and
    wheel radius make it. Lidar curves keep their shape over the score.

    Args:
      noise: by channel, from `standstill_noise`.
      rolling_radius: m of travel per rad of the motor, for an encoder in rad/s.
    """
    changes: dict[str, Any] = {}
    for name in ("accel_x", "accel_y", "yaw_rate"):
      if name in noise:
        changes[f"{name}_bias"] = noise[name].offset
    if "yaw_rate" in noise:
      changes["yaw_rate_std"] = max(noise["yaw_rate"].std, 1e-3)
    encoder = max(noise["motor_speed"].std * rolling_radius if "motor_speed" in noise else 0.0, self.speed_std)
    changes["speed_std"] = encoder
    if "pose_x" in noise and "pose_y" in noise:
      variance = 0.5 * (noise["pose_x"].std ** 2 + noise["pose_y"].std ** 2)
      changes["position_variance"] = self.position_variance.times(
        max(variance, 1e-8) / self.position_variance(self.score)
      )
      colours = [noise[n].correlation for n in ("pose_x", "pose_y") if noise[n].coloured > 0.0]
      changes["lidar_correlation"] = float(np.mean(colours)) if colours else 0.0
      changes["lidar_interval"] = noise["pose_x"].interval
    if "pose_yaw" in noise:
      variance = max(noise["pose_yaw"].std ** 2, 1e-8)
      changes["yaw_variance"] = self.yaw_variance.times(variance / self.yaw_variance(self.score))
    return dataclasses.replace(self, **changes)

  def pose_noise(self, score: Any) -> tuple[Any, Any]:
    """Variance of a lidar position and yaw at a score (float or array) on the lidar's scale, colour allowed for."""
    score, factor = score * (100.0 / self.score_full), self.lidar_factor
    if isinstance(score, np.ndarray):
      return factor * self.position_variance.of(score), factor * self.yaw_variance.of(score)
    return factor * self.position_variance(score), factor * self.yaw_variance(score)

  @cached_property
  def bicycle_noise(self) -> Array:
    """Process noise covariance of EKF_BM over one period, (6, 6), or larger by what is unknown."""
    walks = [self.walk_position] * 2 + [self.walk_speed, self.walk_yaw, self.walk_sideslip, self.walk_yaw_rate]
    drifts = [std / math.sqrt(self.forgetting) for std in self.unknown.values()]
    return np.diag(np.square(walks + drifts) * self.period)

  @cached_property
  def point_noise(self) -> Array:
    """Process noise covariance of EKF_PM over one period, (4, 4): random acceleration and position."""
    h, q = self.period, self.walk_point_velocity**2
    noise = np.zeros((4, 4))
    for i in (0, 1):
      j = i + 2
      noise[i, i] = q * h**3 / 3.0 + self.walk_point_position**2 * h
      noise[i, j] = noise[j, i] = q * h * h / 2.0
      noise[j, j] = q * h
    return noise
