"""Why two sensors of one motion differ by a factor: the one unit, clock, gear or wheelbase that explains all of them.

Each comparison's scale is a product of powers of what may be wrong,

  ln(scale_i / expected_i) = sum_q power_iq ln(factor_q),

so a clock that runs fast shows in turning and in driving alike, a pose in mm wherever a path is an end of a comparison.
A cause is one factor that brings all comparisons within their tolerance. What no single one explains is said of each
comparison alone.
"""

import dataclasses
import math
from collections.abc import Sequence

from calibration.log_check.motions import CLOCK, PLACE, Motion
from calibration.log_check.pairs import Comparison
from qcar_twin.recordings.channels import CHANNELS

ALIKE = 0.8  # correlation of two sensors of one motion that are alike enough to be scaled
LATE = 0.5  # s, from which a lag is no sensor's or servo's, but of the log
FACTOR = 2.0  # between two sensors of one motion, from which a unit or a gear is wrong
KNOTS = 1.5  # the same where geometry ties them: a knot, 0.514 m/s, is the usual unit nearest to 1 m/s
_FAR_APART = 10.0  # of two units, so that one read as the other is no scale of a car's
_A_UNIT = math.log(1.2)  # nearness to a usual unit's factor, as the loader has it


@dataclasses.dataclass(frozen=True)
class Cause:
  """What may be wrong, by which factor it is too large, and how well that explains all comparisons.

  Attributes:
    quantity: a channel, PLACE or CLOCK.
    residual: rms of what is left of the logarithms of their scales.
    unit, scale: the usual unit that has about this factor, "" where none has, and what to multiply by.
  """

  quantity: str
  factor: float
  residual: float
  unit: str
  scale: float

  @property
  def channels(self) -> tuple[str, ...]:
    return ("pose_x", "pose_y") if self.quantity == PLACE else (self.quantity,)


def steered(motion: Motion) -> bool:
  """Whether its scale is the car's, one over the wheelbase."""
  return motion.reference[0] == "steering_command"


def expected(motion: Motion, wheelbase: float) -> float:
  """The scale of two sensors that are right; a steering command in rad turns the car by speed / wheelbase."""
  return 1.0 / wheelbase if steered(motion) else 1.0


def tolerance(motion: Motion) -> float:
  return KNOTS if motion.kinematic else FACTOR


def scaled(c: Comparison) -> bool:
  """Whether a comparison's scale says something."""
  in_time = math.isfinite(c.lag.value) and (c.motion.answers or abs(c.lag.value) <= LATE)
  return not c.why_not and c.correlation > ALIKE and in_time and c.scale.value > 0.0


def apart(c: Comparison, wheelbase: float) -> bool:
  """Whether the two differ by more than their tolerance."""
  return scaled(c) and abs(_log(c, wheelbase)) > math.log(tolerance(c.motion))


def causes(comparisons: Sequence[Comparison], wheelbase: float) -> list[Cause]:
  """Every single cause that explains all comparisons that are apart, best first; only usual units, where one does."""
  usable = [c for c in comparisons if scaled(c)]
  odd = [c for c in usable if apart(c, wheelbase)]
  single = []
  for quantity in dict.fromkeys(q for c in odd for q in c.motion.powers):
    powers = [c.motion.powers.get(quantity, 0) for c in odd]
    if not all(powers):
      continue
    factor = sum(_log(c, wheelbase) / p for c, p in zip(odd, powers, strict=True)) / len(odd)
    left = [_log(c, wheelbase) - c.motion.powers.get(quantity, 0) * factor for c in usable]
    if all(abs(rest) < math.log(tolerance(c.motion)) for rest, c in zip(left, usable, strict=True)):
      unit, scale = _unit(quantity, factor)
      residual = math.sqrt(sum(rest**2 for rest in left) / len(left))
      single.append(Cause(quantity, math.exp(factor), residual, unit, scale))
  single = [cause for cause in single if cause.unit] or single
  return sorted(single, key=lambda cause: round(cause.residual, 2))


def cure(cause: Cause, wheelbase: float, stated: bool) -> str:
  """What to write for a cause; `stated`: whether the wheelbase is the data set's, or the nominal car's."""
  on = "pose_x and on pose_y" if cause.quantity == PLACE else cause.quantity
  multiply = f"set scale = {cause.scale:.4g} on {on} in [channels], times one that is there"
  if cause.quantity == CLOCK:
    return f"the stamps run {cause.factor:.3g} times as fast as the car: {multiply}; a rate is divided by that"
  name = "the pose" if cause.quantity == PLACE else cause.quantity
  if cause.quantity == "steering_command" and not cause.unit:
    said = f"the car turns like one of wheelbase {wheelbase * cause.factor:.3g} m, and [vehicle] says"
    if not stated:
      return f"{said} none, so that the nominal car's {wheelbase:.3g} m stand in: give cg_to_front and cg_to_rear there"
    return f"{said} {wheelbase:.3g} m: correct cg_to_front and cg_to_rear in [vehicle], or {multiply}"
  said = f"is {name} in {cause.unit}? {multiply}" if cause.unit else f"{name} reads {cause.factor:.3g}-fold: {multiply}"
  wheels = ", or correct gear_ratio or wheel_radius in [vehicle] by it" if cause.quantity == "motor_speed" else ""
  return f"{said}{wheels}"


def _log(c: Comparison, wheelbase: float) -> float:
  return math.log(c.scale.value / expected(c.motion, wheelbase))


def _unit(quantity: str, factor: float) -> tuple[str, float]:
  """The usual unit with about this factor and its scale; else no unit, and what undoes the factor."""
  channel = CHANNELS.get("pose_x" if quantity == PLACE else quantity)
  usual = channel.log_units if channel and quantity != CLOCK else ()
  si = ((channel.unit, 1.0), *usual) if channel and usual else ()
  mistaken = [(f"{u}, read as {v}", a / b) for u, a in si for v, b in si[1:] if max(a / b, b / a) >= _FAR_APART]
  usual = (*usual, *mistaken)
  unit, scale = min(usual, key=lambda named: abs(factor + math.log(named[1])), default=("", math.exp(-factor)))
  return (unit, scale) if abs(factor + math.log(scale)) < _A_UNIT else ("", math.exp(-factor))
