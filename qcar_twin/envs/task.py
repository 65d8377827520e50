"""The path-tracking task: what the agent does, what it is paid for, when an episode ends.

Action: rate of the steering angle. Observation: cross-track error, its rate, heading error, its rate. Reward and
ends are the paper's eqs. (reward) and (r_decomposition); its thresholds and weights are not printed, the defaults
here converge. One task object serves every environment.
"""

import dataclasses
import math
import numbers
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.paths import Path
from qcar_twin.vehicle.vehicle import QCAR

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
ERROR_SCALE = (20.0, 5.0, 5.0, 1.0)  # 1/m, s/m, 1/rad, s/rad: the four errors of a car on its way become of order one


def refuse_numbers(owner: Any, positive: Sequence[str] = (), never_negative: Sequence[str] = ()) -> None:
  """Refuse what a field of a data class cannot be whose default is a number.

  Raises:
    TypeError: no number, or no whole one where the default is whole.
    ValueError: not finite, or beyond its range.
  """
  for field in dataclasses.fields(owner):
    value, whole = getattr(owner, field.name), isinstance(field.default, int)
    if isinstance(field.default, bool) or not isinstance(field.default, (int, float)):
      continue
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, numbers.Integral if whole else numbers.Real):
      raise TypeError(f"{field.name} is {value!r}; it must be a {'whole ' * whole}number, as {field.default:g}")
    if not math.isfinite(value):
      raise ValueError(f"{field.name} is {value}; it must be finite, as {field.default:g}")
    if value < 0 and field.name in never_negative:
      raise ValueError(f"{field.name} is {value:g}; it must not be negative")
    if value <= 0 and field.name in positive:
      raise ValueError(f"{field.name} is {value:g}; it must be positive")


@dataclasses.dataclass(frozen=True)
class Reward:
  """Weights and thresholds of the reward, in the paper's notation.

  Attributes:
    m1, m2: of ln|cross-track error / 1 m| within and beyond `near`.
    m3, m4: of ln|heading error / 1 rad| within and beyond `aligned`.
    m5: per steering rate, s/rad.
    m6: per difference from the demonstrator's steering angle, 1/rad; 0 for an agent without one.
    lost_penalty: M, paid once when the car is lost.
    near: th_l, cross-track error below which the reward is flat, m: it sets the bias an agent is content with.
    aligned: th_psi, rad.
  """

  m1: float = 0.1
  m2: float = 0.1
  m3: float = 0.03
  m4: float = 0.03
  m5: float = 0.05
  m6: float = 0.5
  lost_penalty: float = 10.0
  near: float = 0.002
  aligned: float = 0.02

  def __post_init__(self) -> None:
    refuse_numbers(self, positive=("near", "aligned"), never_negative=("lost_penalty",))

  def cross_track(self, error: Array, lost: Mask) -> Array:
    """r_y of cross-track errors, m; -M where the car is lost."""
    size = np.abs(error)
    flat = -self.m1 * math.log(self.near)
    value = np.where(size <= self.near, flat, -self.m2 * np.log(np.maximum(size, self.near)))
    return np.where(lost, -self.lost_penalty, value)

  def heading(self, error: Array) -> Array:
    """r_psi of heading errors, rad."""
    size = np.abs(error)
    flat = -self.m3 * math.log(self.aligned)
    return np.where(size <= self.aligned, flat, -self.m4 * np.log(np.maximum(size, self.aligned)))

  def terms(self, cross_track: Array, heading: Array, rate: Array, difference: Array, lost: Mask) -> dict[str, Array]:
    """What the reward is the sum of, by name, (N,) each; arguments as of `TrackingTask.judge`."""
    seen = np.isfinite(heading)
    return {
      "cross_track": self.cross_track(np.nan_to_num(cross_track), lost),
      "heading": np.where(seen, self.heading(np.where(seen, heading, 0.0)), 0.0),
      "steering_rate": -self.m5 * np.abs(rate),
      "demonstrator": -self.m6 * np.abs(np.nan_to_num(difference)),
    }


POSITIVE = ("speed", "laps", "lost", "largest_rate", "lock", "period")
NEVER_NEGATIVE = ("start_offset", "start_heading", "gain_spread", "offset_spread", "servo_delay", "servo_lag")


@dataclasses.dataclass(frozen=True)
class TrackingTask:
  """The episodes of an environment: path, speed, reward, what is drawn, and when one ends.

  A single run that is measured is a `Scenario` (agents/control/closed_loop.py).

  Attributes:
    path: followed from its start.  speed: m/s, held by a speed controller.  laps: of a closed path.
    speed_spread: the speed is drawn again for every episode, uniformly within +- this around it, m/s.
    reward: weights.  lost: th_u, cross-track error that ends an episode, m.
    largest_rate: bound of the action, rad/s.  lock: of the steering angle, rad.
    start_offset, start_heading: episodes start uniformly within +- these, m and rad.
    steering_gain, steering_offset: of the linkage, - and rad; neither agent nor filter knows them.
    gain_spread, offset_spread: the linkage is drawn again for every episode, uniformly within +- these around them.
    servo_delay, servo_lag: s, for plants that have no servo of their own.
    judged_by_truth: reward and ends from the true state, as a simulator allows; else from the estimate.
    period: control period, s; a fleet takes its plant's.
    stretch: episodes begin anywhere on the path and end after so many m; 0: they go from its start to its end.
  """

  path: Path
  speed: float = 0.5
  laps: int = 1
  reward: Reward = Reward()
  lost: float = 0.2
  largest_rate: float = 1.5
  lock: float = QCAR.max_steering
  start_offset: float = 0.05
  start_heading: float = 0.1
  steering_gain: float = 1.0
  steering_offset: float = 0.0
  gain_spread: float = 0.0
  offset_spread: float = 0.0
  servo_delay: float = 0.0
  servo_lag: float = 0.0
  judged_by_truth: bool = True
  period: float = 0.01
  stretch: float = 0.0
  speed_spread: float = 0.0

  def __post_init__(self) -> None:
    refuse_numbers(self, POSITIVE, NEVER_NEGATIVE)
    if not 0.0 <= self.speed_spread < self.speed:
      raise ValueError(
        f"a spread of {self.speed_spread:g} m/s around {self.speed:g} m/s: from 0 on and less than the speed"
      )
    if not self.gain_spread < abs(self.steering_gain):
      raise ValueError(
        f"gains within {self.gain_spread:g} around {self.steering_gain:g} could turn the steering round: give a smaller"
        " gain_spread"
      )
    if not self.reward.near < self.lost:
      raise ValueError(f"the reward is flat within {self.reward.near:g} m, the car lost at {self.lost:g} m: swap them")

    if not 0.0 <= self.stretch <= self.path.length:
      raise ValueError(
        f"a stretch of {self.stretch:g} m of path '{self.path.name}', which has {self.path.length:.1f} m"
      )

  @property
  def distance(self) -> float:
    """Arc length after which an episode is finished, m."""
    return self.stretch or self.path.length * (self.laps if self.path.closed else 1)

  @property
  def longest(self) -> int:
    """Control periods after which an episode is cut off: a quarter more than the way takes at the slowest speed."""
    return math.ceil(1.25 * self.distance / ((self.speed - self.speed_spread) * self.period))

  def target(self, rng: np.random.Generator) -> float:
    """Speed of one episode, m/s; nothing is drawn where there is no spread."""
    return self.speed + (float(rng.uniform(-1.0, 1.0)) * self.speed_spread if self.speed_spread else 0.0)

  def begins_at(self, rng: np.random.Generator) -> float:
    """Arc length at which an episode begins, m; nothing is drawn where all begin at the path's start."""
    if not self.stretch:
      return 0.0
    return float(rng.uniform(0.0, self.path.length - (0.0 if self.path.closed else self.stretch)))

  def start_state(self, rng: np.random.Generator, arc_length: float = 0.0, speed: float | None = None) -> Array:
    """A start drawn for one car, (7,) as `plant.START` has it: near the path at an arc length, m, at its speed, m/s
    (the task's without it), wheels straight."""
    offset, turned = rng.uniform(-1.0, 1.0, 2) * (self.start_offset, self.start_heading)
    at = self.path.at(arc_length)
    x, y, yaw = float(at.x), float(at.y), float(at.yaw)
    place = x - offset * math.sin(yaw), y + offset * math.cos(yaw), yaw + turned
    return np.array([*place, self.speed if speed is None else speed, 0.0, 0.0, 0.0])

  def linkage(self, rng: np.random.Generator) -> tuple[float, float]:
    """Steering gain, -, and offset, rad, of one episode; nothing is drawn where there is no spread."""
    if not (self.gain_spread or self.offset_spread):
      return self.steering_gain, self.steering_offset
    gain, offset = rng.uniform(-1.0, 1.0, 2) * (self.gain_spread, self.offset_spread)
    return self.steering_gain + gain, self.steering_offset + offset

  def judge(self, cross_track: Array, heading: Array, rate: Array, difference: Array) -> tuple[dict[str, Array], Mask]:
    """The reward's terms by name and whether the car is lost, (N,) each.

    Args:
      cross_track, heading: after the period, m and rad.
      rate: action of the period, rad/s.  difference: of the steering angle from the demonstrator's, rad.
    """
    lost = ~np.isfinite(cross_track) | (np.abs(cross_track) >= self.lost)
    return self.reward.terms(cross_track, heading, rate, difference, lost), lost
