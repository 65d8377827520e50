"""What nothing else in a log measures: its clock, sensors that are alone with their motion, a car nobody measured.

A rate that a sensor gave (a gyro's, an encoder's, an accelerometer's), compared with how fast something else changed by
the stamps, does. Commands and a pose alone do not: at half the speed of its clock the same log is of a car that drove
twice as fast.
"""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from calibration.log_check.causes import ALIKE, KNOTS, scaled, steered
from calibration.log_check.disagreements import Finding
from calibration.log_check.motions import CLOCK, Wheels
from calibration.log_check.pairs import Comparison
from calibration.log_check.shows import Driven
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.completed import UNJUDGED
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import GRAVITY

_WITNESSED = ("speed", "motor_speed", "yaw_rate", "accel_x", "accel_y", "pose_x", "pose_yaw")
_SCALED = ("speed", "motor_speed", "yaw_rate")  # what everything else is scaled by
_MEASURE = {
  "speed": "drive a way that was measured, and compare the speed added up with it",
  "motor_speed": "drive a way that was measured, and compare motor_speed, gear_ratio and wheel_radius with it",
  "yaw_rate": "turn the car by whole turns, and compare the yaw rate added up with them",
}
_GUESS = 0.2  # of a length: its deviation where nobody measured it; a ruler's is below a hundredth
_MOST = 99.0  # per cent of the samples that stay below what is said of the driving
_GRIP, _SEEN = 2.0, 0.1  # g across: more than tyres hold without wings; less than curves take


def clock_findings(
  comparisons: Sequence[Comparison], wheels: Wheels, wheelbase: float, recordings: Sequence[Recording]
) -> list[Finding]:
  """That the clock was not judged, and how the car was driven by it: whoever drove knows that."""
  if any(scaled(c) and CLOCK in c.motion.powers for c in comparisons):
    return []
  d = Driven.of(wheels, wheelbase, recordings)
  across, along = (float(np.percentile(np.abs(v), _MOST)) / GRAVITY for v in (d.across, d.change))
  said = f"the clock {UNJUDGED}: nothing in this log measures time apart from its stamps"
  by_it = f"By them the car reached {d.top:.2g} m/s, {along:.1g} g along and {across:.1g} g across"
  return [Finding("beware", ("time",), f"{said}. {by_it}; if it did not, correct scale of time in [channels]")]


def grip_findings(
  comparisons: Sequence[Comparison], wheels: Wheels, wheelbase: float, recordings: Sequence[Recording]
) -> list[Finding]:
  """That the car went round faster than tyres hold, by its speed and its gyro, and no accelerometer says so, too: one
  of them, or the clock, is in another unit."""
  turning = [r for r in recordings if "yaw_rate" in r and wheels.channel in r]
  if not turning or any("accel_y" in c.motion.compared and _tells(c) for c in comparisons):
    return []
  across = float(np.percentile(np.abs(Driven.of(wheels, wheelbase, turning).across), _MOST)) / GRAVITY
  if across <= _GRIP:
    return []
  said = f"by {wheels.channel} and yaw_rate the car went round with {across:.2g} g, and tyres hold {_GRIP:g} g at most"
  units = [
    f"is {name} in {unit}? set scale = {factor:.6g} on {name} in [channels], times one that is there"
    for name in (wheels.channel, "yaw_rate")
    for unit, factor in CHANNELS[name].log_units[:1]
    if _SEEN < across * factor < _GRIP
  ]
  cure = "; ".join(units) or f"look at the units of {wheels.channel} and yaw_rate, and of time, in [channels]"
  return [Finding("beware", (wheels.channel, "yaw_rate"), f"{said}: one of them, or time, is in another unit; {cure}")]


def lonely_findings(
  comparisons: Sequence[Comparison], recordings: Sequence[Recording], told: Collection[str] = ()
) -> list[Finding]:
  """That sensors' units, signs and ages are taken as they are written, since no other sensor shows their motion.

  `told`: channels that are said to be wrong already.
  """
  known = {*told} | {name for c in comparisons if _tells(c) for name in (*c.motion.compared, *c.motion.reference)}
  held = {name for r in recordings for name in r.channels if name not in r.derived}
  alone = [name for name in _WITNESSED if name in held - known]
  if not alone:
    return []
  who = " and ".join(alone) if len(alone) < 3 else f"{', '.join(alone[:-1])} and {alone[-1]}"
  said = f"unit, sign and age of {who} {UNJUDGED}: nothing else in this log shows enough of the motion"
  return [Finding("beware", tuple(alone), f"{said}; what [channels] says of them is believed")]


def loose_findings(comparisons: Sequence[Comparison], recordings: Sequence[Recording]) -> list[Finding]:
  """That the scale of a speed or of a gyro is known no better than accelerometers tell it, and what they say of it.

  They also feel tilt and slip: a body that leans out of a turn by 0.02 rad per m/s^2 shows a fifth too much.
  """
  findings = []
  for name in _SCALED:
    if not any(name in r and name not in r.derived for r in recordings):
      continue
    witnesses = [c for c in comparisons if name in c.motion.powers and _tells(c) and not steered(c.motion)]
    if not witnesses or any(c.motion.kinematic for c in witnesses):
      continue
    heard = [
      f"{c.motion.compared[0]} shows {c.felt.value:.2f} of {c.motion.name}, ± {c.felt.std:.1g} by its noise alone"
      for c in witnesses
    ]
    said = (
      f"the scale of {name} {UNJUDGED} to better than a factor of {KNOTS:g}: of what was logged only accelerometers"
    )
    cure = _MEASURE[name]
    findings += [
      Finding("beware", (name,), f"{said} tell it, which feel tilt and slip besides ({', '.join(heard)}); {cure}")
    ]
  return findings


def guessed_findings(
  comparisons: Sequence[Comparison], vehicle: Mapping[str, float | str], std: Mapping[str, float]
) -> list[Finding]:
  """That steering and wheelbase cannot be told apart where the wheelbase is a guess.

  Steering shows as angle / wheelbase in a log, so an understeer is taken for length, and a length that is off for a
  scale of the gyro or of the steering.
  """
  lengths = ("cg_to_front", "cg_to_rear")
  if not all(std.get(name, 0.0) > _GUESS * float(vehicle.get(name, 0.0)) > 0.0 for name in lengths):
    return []
  if not any("steering_command" in c.motion.reference and not c.why_not for c in comparisons):
    return []
  wheelbase, spread = sum(float(vehicle[name]) for name in lengths), math.hypot(*(std[name] for name in lengths))
  said = (
    f"scale of steering_command and wheelbase {UNJUDGED} apart: by [vehicle.std] the {wheelbase:.3g} m are known to"
  )
  cure = (
    "a steering mechanism or a gyro_scale that is diagnosed may be that; measure cg_to_front and cg_to_rear, and write "
    "their deviations"
  )
  return [Finding("beware", ("steering_command",), f"{said} {spread:.2g} m; {cure}")]


def _tells(c: Comparison) -> bool:
  """Whether a comparison says something of both sensors' scales."""
  return not c.why_not and not c.motion.answers and (c.correlation > ALIKE or c.felt.beyond(0.0))
