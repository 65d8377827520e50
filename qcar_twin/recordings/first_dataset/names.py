"""What the name of a log's column says: its words, its unit, and the channels that it may be."""

import functools
import re
from dataclasses import dataclass

from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.formats.axles import MEAN, NO_SPEEDS, SIDES
from qcar_twin.recordings.unit_names import BRACKET, COMMANDED, UNITS, bracketed, unit_of, words_of

# who measures a place, and what it is called
_PLACES = (
  "pose|poses|pos|position|positions|location|vicon|mocap|optitrack|lidar|slam|map|world|loc|tf|pf|amcl|rb|cam|camera|mc"
  "|marker|tracker|state|gps|gnss"
)

# words that make a column a channel: all of the terms, each in one of its spellings, `command` in any of COMMANDED;
# after "!" words that forbid it
# what a message about the throttle has besides it
_MEASURED = "|speed|spd|velocity|vel|rpm|erpm|acceleration|accel|acc|voltage|volt|volts|current|amps|temp|temperature"
# what is "current" in the sense of now: CurrentLap, current_speed
_QUALIFIED = (
  "lap|laps|race|sector|gear|rpm|erpm|speed|spd|velocity|vel|position|pose|heading|yaw|angle|steering|waypoint|state"
  "|mode|step|run"
)
_TURNING = "rotation|rotational|rotary"  # of a wheel: an angular speed
_RULES: dict[str, tuple[str, ...]] = {
  "time": (
    "ms today",
    "elapsed|log|system|ros time|stamp|clock",
    "time|timestamp|tstamp|stamp|clock|elapsed|tout|ts|t",
  ),
  "motor_voltage": (
    "motor|mot|command|applied|armature|input|esc|drive|throttle voltage|volt|volts !battery|bat|batt|supply|measured",
    "motor|mot|cmd|commanded|applied|armature|input|esc|drive|throttle v !battery|bat|batt|supply|measured",
    "voltage|volts !battery|bat|batt|vbat|supply|measured",
    "motor|mot u !measured",
  ),
  "motor_duty": (
    f"duty|pwm|throttle|gas|thr !steering|steer|servo|servos{_MEASURED}",
    f"duty|pwm|throttle|gas|thr command !steering|steer|servo|servos{_MEASURED}",  # a drive's telemetry has a duty, too
    "actuator|actuators motor|motors",
    "motor|mot|engine command !steering|steer|servo|servos|angle|speed|spd|velocity|vel|rpm|erpm|rps|omega|w|rad"
    "|voltage|volt|volts|v|u|current|amps|a|i|iq|torque|force|acceleration|accel|acc|position|pos|ticks|temp"
    "|temperature",
    "esc !voltage|volt|volts|v|current|amps|temp|temperature|rpm|speed|steering|servo",
    "pedal|accelerator !brake|clutch|steering",
  ),
  "motor_current": (
    f"current|amps command !{_QUALIFIED}",
    "axis|odrive|odrv iq setpoint",
  ),
  "speed_command": (
    "speed|spd|velocity|vel|v|rpm|erpm command|control !angular|ang|yaw|steering|z|y",
    "axis|odrive|odrv vel input|setpoint",
  ),
  "acceleration_command": ("accel|accl|acc|acceleration|a command|input|u !angular|ang|yaw|steering|lateral|lat|z|y",),
  "steering_command": (
    "steering|steer|steered|servo|servos|delta|deltawheel|df|str"
    " !measured|actual|feedback|fb|report|reported|velocity|rate|speed",
    "direction command !measured|actual|feedback|fb|report|reported|speed|rate|motor|gear",
    "wheel angle !measured|actual|feedback|fb|report|reported",
    "user|pilot|joystick|joy angle !measured|actual|feedback|fb|report|reported",
  ),
  "motor_speed": (
    "motor|tach|tacho|shaft speed|velocity|vel|omega|rpm|rps|rate|w !command",
    "wheel|wheels|encoder|enc|motor|mot|rotor rad|omega|w|rpm|rps !angle|steering|steer|position|pos|imu|gyro|command",
    f"wheel|wheels {_TURNING} speed|spd|velocity|vel|rate !command",
    "rpm !e|command",
    "rps !gyro|gyr",
    "e rpm !command",
    "erpm !command",
    "sensors core speed",
    "vesc state speed",
    "axis|odrive|odrv vel estimate",
  ),
  "speed": (
    f"speed|spd|velocity|vel|vels|v !angular|yaw|gyro|motor|command|steering|y|z|lateral|{_TURNING}",
    "v enc|encoder|meas|measured|actual|act|odom|odo|wheel|rl|rr|hl|hr|fl|fr|vl|vr !y|z|command",
    "v long|longitudinal|lon !command",
    "vx|vlong !position|pos|pose|map|world|global|local|ned|enu",
    "v ego",
    "motor tach !command|rpm|rad",
    "twist|odom|vel|vels linear x !angular|acceleration|accel|acc|command",
  ),
  "accel_x": (
    "acc|accel|acl|acceleration|accelerometer|a x|forward|fwd|long|longitudinal|lon !angular|command",
    "g|gforce lon|long|longitudinal",
    "ax|accx|accelx !angular",
    "a ego",
  ),
  "accel_y": (
    "acc|accel|acl|acceleration|accelerometer|a y|left|lat|lateral !angular|command",
    "g|gforce lat|lateral",
    "ay|accy|accely !angular",
  ),
  "yaw_rate": (
    "yaw|heading|psi|turn rate|dot|punkt|speed|velocity|vel !command",
    "psi p",
    "gyro|gyroscope|gyr|angular|ang|omega|w z|yaw"
    " !accel|acc|acl|acceleration|accelerometer|linear|wheel|motor|mag|command",
    "imu z !accel|acc|acl|acceleration|accelerometer|a|linear|mag|orientation|q|quat|quaternion|position|pos",
    "rate rotation z",
    "angular speed|velocity|vel|rate !x|y|motor|wheel|command",
    "gyro|gyroscope !x|y",
    "g z !acc|accel|acceleration|force",
    "wz|gz|gyroz|gyrz|yawrate|omegaz|dpsi|dyaw|psidot|psip|psipunkt|yawdot|r",
    "w psi|yaw !command",
    "omega !motor|wheel|shaft|left|right|x|y|command",
    "w imu|gyro",
  ),
  "pose_x": (
    f"{_PLACES} x|px !acc|vel|velocity|rate",
    "px|tx",
    "x !g|a",
    "east|easting !acc|vel|velocity|speed|rate",
  ),
  "pose_y": (
    f"{_PLACES} y|py !acc|vel|velocity|rate",
    "py|ty",
    "y !g|a",
    "north|northing !acc|vel|velocity|speed|rate",
  ),
  "pose_yaw": (
    "yaw|heading|hdg|theta|psi|phi|orientation|compass|azimuth|bearing"
    " !rate|dot|punkt|p|vel|velocity|speed|gyro|x|z|w|command",
    "rz !rate|vel|velocity|speed",
  ),
  "pose_score": ("score|confidence|quality",),
  "battery_voltage": ("battery|bat|batt|vbat|supply !current|percent|percentage|charge|level|soc|temperature|power",),
  "armature_current": (
    f"current|amps !command|battery|supply|time|in|input|{_QUALIFIED}",
    f"current|amps motor|mot|armature|phase !command|in|input|{_QUALIFIED}",
    "axis|odrive|odrv iq measured",
    "motor|mot|armature i !command",
  ),
}
# of the first group of controls of PX4 before 1.14 (docs.px4.io, "Mixing and Actuators"): yaw and throttle, which steer
# and drive a rover
_PX4 = re.compile(r"actuator_controls_0\w*\W+control\[(?P<place>\d)\]$")
_PX4_CONTROLS = ("", "", "steering_command", "motor_duty")
# of PX4 since 1.14 (msg/ActuatorServos.msg, ActuatorMotors.msg): a rover's first servo steers
_PX4_OUTPUTS = re.compile(r"actuator_(?P<what>servos|motors)(_0)?\W+control\[0\]$")
_MEAN = 0.3  # what the mean of two wheels has before either
_PULSES = ("us", "µs")  # what radio-control servos and speed controllers are commanded in
_ODOMETRY = {"odom", "odometry"}  # whose turning is of wheel speeds or of the commanded steering, and no sensor's
_DID = {"act", "joint", "joints", "pot"}  # what a servo did, as a sensor at it says, and as a command is seldom called
_RAW, _SMOOTH = (
  {"raw"},
  {"filtered", "filt", "smoothed", "smooth", "ema", "avg", "average", "estimated", "est", "lowpass"},
)


@dataclass(frozen=True)
class Reading:
  """A channel that a column's name may mean.

  Attributes:
    score: how well it fits; terms of the rule that were met, more for a unit that fits, less for values worked out.
    why: in words.
  """

  channel: str
  score: float
  why: str


def readings(column: str) -> list[Reading]:
  """Channels that the name may mean, best first."""
  if column.startswith(MEAN):
    wheel = column.removeprefix(MEAN).partition(" and ")[0]
    more = "the mean of an axle's wheels, which is that of its middle"
    return [Reading(one.channel, one.score + _MEAN, f"{one.why}; {more}") for one in readings(wheel)]
  if column in CHANNELS:
    return [Reading(column, 10.0, "it has the channel's name")]
  if (control := _PX4.search(column)) is not None:
    place = int(control["place"])
    channel = _PX4_CONTROLS[place] if place < len(_PX4_CONTROLS) else ""
    return [Reading(channel, 3.0, f"PX4's control[{place}] of the first group")] if channel else []
  if (output := _PX4_OUTPUTS.search(column)) is not None:
    channel = "steering_command" if output["what"] == "servos" else "motor_duty"
    return [Reading(channel, 3.0, f"PX4's first of actuator_{output['what']}")]
  words, unit = set(words_of(bracketed(column))), unit_of(column)
  bare = set(words_of(BRACKET.sub(" ", bracketed(column))))
  possible = []
  for channel, rules in _RULES.items():
    met = [terms for rule in rules if (terms := _met(rule, words, bare))]
    if not met and channel in ("speed", "motor_speed", "motor_duty"):
      met = _of_a_unit(channel, words, unit)
    if not met:
      continue
    best = max(met, key=len)
    score = len(best) + 0.5 * len(set(best)) / len(words)
    worked_out = words & _SMOOTH or (channel == "yaw_rate" and words & _ODOMETRY)
    score += 0.2 * bool(words & _RAW) - 0.5 * bool(worked_out)
    score -= 1.0 * bool(channel == "steering_command" and words & _DID and not words & set(COMMANDED))
    pulse = unit is not None and unit[0] in _PULSES and channel in ("motor_duty", "steering_command")
    share = unit is not None and unit[1] == "-" and channel == "steering_command"  # of full lock
    if unit is not None and unit[1] == "-" and channel == "acceleration_command":
      channel = "motor_duty"  # an accelerator's travel, which commands no m/s^2
    fits = unit is None or unit[1] == CHANNELS[channel].unit or pulse or share
    letter = unit is not None and len(unit[0]) == 1 and not BRACKET.search(column)  # gyro_a is not in amperes
    if not fits and not letter:
      score -= 2.0
    elif unit is not None and fits:
      score += 0.5
    if score > 0.0:
      possible.append(Reading(channel, score, f"its name says {' '.join(best)}"))
  return sorted(possible, key=lambda reading: -reading.score)


def _of_a_unit(channel: str, words: set[str], unit: tuple[str, str, float] | None) -> list[tuple[str, ...]]:
  """What makes a column the car's or the motor's speed by its unit: a wheel's, over ground or turning; a name that is
  nothing but a unit of speed. What makes one a duty: a torque that was asked for as a share of the full one, as by a
  pedal."""
  if channel == "motor_duty":
    asked = words & {"torque", "trq"} and words & set(COMMANDED) and not words & {"brake", "steering", "steer", "wheel"}
    return [("torque",)] if asked and unit is not None and unit[1] == "-" else []
  of_wheel = words & {"wheel", "wheels"} and not words & set(COMMANDED)
  if unit is None:
    return [("wheel",)] if channel == "speed" and of_wheel and words & SIDES and not words & NO_SPEEDS else []
  if unit[1] != CHANNELS[channel].unit:
    return []
  if of_wheel:
    return [("wheel",)] if channel == "speed" or not words & NO_SPEEDS else []
  return [(unit[0],)] if channel == "speed" and words == set(words_of(unit[0])) else []


@functools.cache
def _spellings(term: str) -> tuple[str, ...]:
  """The words that meet a term of a rule; `command` stands for all words that say so."""
  return tuple(word for one in term.split("|") for word in (COMMANDED if one == "command" else (one,)))


def _met(rule: str, words: set[str], bare: set[str]) -> tuple[str, ...]:
  """The words that meet a rule, one per term; empty where one is not met or a forbidden one is there. `bare`: those
  outside brackets."""
  wanted, _, forbidden = rule.partition(" !")
  if words & set(_spellings(forbidden)):
    return ()
  terms = [next((word for word in _spellings(term) if word in words), "") for term in wanted.split(" ")]
  if len(terms) == 1 and len(terms[0]) == 1 and any(word not in UNITS for word in bare - set(terms)):
    return ()  # a letter is a name only where it stands alone
  return tuple(terms) if all(terms) else ()
