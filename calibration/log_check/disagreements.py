"""What two sensors of one motion that disagree mean for a fit: a finding, with the cure that makes them agree.

How far each level below could be moved without an error, on sound and on false logs, is measured by
`python -m tests.faults.thresholds --sensors`.
"""

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Literal

from calibration.fitting.noise import ChannelNoise
from calibration.log_check.alternatives import Alternative, agreeing
from calibration.log_check.causes import ALIKE, FACTOR, KNOTS, LATE, apart, causes, cure, expected, scaled, steered
from calibration.log_check.motions import Wheels
from calibration.log_check.pairs import Comparison, Estimate
from qcar_twin.recordings.completed import UNJUDGED
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.mechanisms import catalogue

Severity = Literal["spoils", "beware", "note"]
_PERIOD = 0.01  # s, of the twin's control: a lag below it is no finding
_SCALE = 0.01  # a sensor's usual tolerance of sensitivity; a scale within it is no finding
_CONTRARY = -0.5  # correlation of two sensors of one motion that contradict each other
TIED = 0.95  # correlation of two that geometry ties, below which another reading may explain more of them
_BETTER = 0.5  # of what is left unexplained: at most so much is left by another reading that is better
_LISTED = 3  # stretches that are named
_FAR = 3.0  # deviations of a sensor's usual zero, beyond which it is said
_ZEROS = {
  "yaw_rate": ("gyro_bias", "gyro_bias"),
  "accel_x": ("accel_bias", "accel_bias_x"),
  "accel_y": ("accel_bias", "accel_bias_y"),
}
# s, after which cars answer their steering: 0.02 (data/sample) to 0.19 (cpm_ucar), in `comparisons` of check.json
_ANSWERS = 0.1
# s, from which a speed is late against an accelerometer: in 39 sound logs of three other people's simulators in which
# the two are as much alike as TIED has it, it is 0.054 at most (by hand, docs/results/logs.md); a GPS receiver has 0.16
_FELT_LATE = 0.1
_LOUD = 3.0  # times the compared sensor's noise that a motion must be for the two to be alike


@dataclasses.dataclass(frozen=True)
class Finding:
  """Something to know: `spoils` what is fitted, `beware`, or a `note`; channels it is about, and a sentence with the
  cure."""

  severity: Severity
  channels: tuple[str, ...]
  text: str


def disagreements(
  c: Comparison,
  wheels: Wheels,
  wheelbase: float,
  recordings: Sequence[Recording],
  noise: Mapping[str, ChannelNoise],
  timed: Collection[str] = (),
) -> list[Finding]:
  """Findings about the two sensors of one motion, none where they agree or could not be compared.

  Args:
    c: their comparison.
    wheelbase: of the car, m; a steering command in rad turns it by speed / wheelbase.
    recordings, noise: what was compared, for trying other readings of the channels.
    timed: channels whose lags geometry tells, so that `lag_findings` says them.
  """
  if c.why_not or c.motion.answers:
    return []
  channels = (*c.motion.compared, *c.motion.reference)
  names = _names(c)
  nominal = expected(c.motion, wheelbase)
  spoils = lambda text: [Finding("spoils", channels, text)]
  if _in_doubt(c):
    good, tried = agreeing(c.motion, wheels, recordings, noise)
    good = [pair for pair in good if c.correlation < ALIKE or _left(pair[1]) < _BETTER * _left(c)]
    if good:
      return spoils(f"{names} {_say(c)}: {_cures(good)}")
    if c.correlation < ALIKE and _unrelated(c, nominal):
      return spoils(
        f"{names} {_say(c)}: one of them is another channel, or damaged; tried in vain: {', '.join(tried)}, another "
        "age of 10 s"
      )
  if c.correlation < _CONTRARY:
    return spoils(f"{names} {_say(c)}; set scale = -1 on it in [channels]")
  if c.correlation <= ALIKE and not c.motion.kinematic:
    return _hardly_alike(c, nominal)
  if not math.isfinite(c.lag.value):
    return spoils(_not_in_time(c, names)) if c.motion.kinematic or not set(channels) & set(timed) else []
  if abs(c.lag.value) > LATE:
    return spoils(_far_apart(c))
  if apart(c, wheelbase):
    return []
  return [*_odd(c), *_off_zero(c), *(_off_scale(c) if c.motion.kinematic else ())]


def scale_findings(comparisons: Sequence[Comparison], wheelbase: float, stated: bool) -> list[Finding]:
  """What is said of sensors that differ by a factor: one cause for all of them, or of each alone where none is.

  `stated`: whether the wheelbase is the data set's, or the nominal car's.
  """
  odd = [c for c in comparisons if apart(c, wheelbase)]
  common = causes(comparisons, wheelbase)
  findings = []
  for group in [odd] if common else [[c] for c in odd]:
    single = common or causes(group, wheelbase)
    channels = tuple(dict.fromkeys(name for cause in single for name in cause.channels))
    said = "; ".join(
      f"{_names(c)} differ {c.scale.value / expected(c.motion, wheelbase):.3g}-fold in {c.motion.name}" for c in group
    )
    cures = ", or ".join(cure(cause, wheelbase, stated) for cause in single)
    findings.append(Finding("spoils", channels, f"{said}: {cures}"))
  return findings or [f for c in comparisons for f in _far_off(c, expected(c.motion, wheelbase))]


def _hardly_alike(c: Comparison, nominal: float) -> list[Finding]:
  """Of two that are not contrary and that noise, slip or tilt part: a scale beyond three deviations, or that this
  driving says nothing of them.

  A scale is said where the sensor shows the motion above its noise: at a held speed it feels the car's turning more.
  """
  channels = (*c.motion.compared, *c.motion.reference)
  felt, spread = c.felt.value / nominal, 3.0 * c.felt.std / nominal
  if felt - spread > FACTOR and abs(c.felt.value) * c.loud > _LOUD * c.levels[0]:
    cure = f"divide the scale of {_list(c.motion.compared)} in [channels] by that, or correct its unit"
    return [Finding("spoils", channels, f"{_names(c)} differ {felt:.3g}-fold in {c.motion.name}: {cure}")]
  if felt - spread > 0.0:
    return [] if math.isfinite(c.lag.value) and not c.elsewhere else [_of_no_age(c)]
  if not c.loud > _LOUD * c.levels[0]:
    return []  # `lonely_findings` says that nothing judges it
  said = f"whether {_list(c.motion.compared)} shows {c.motion.name} cannot be decided from this driving"
  cure = "look at its axis and sign, or drive longer"
  return [
    Finding("beware", channels, f"{said} (correlation {c.correlation:.2f} with {_list(c.motion.reference)}); {cure}")
  ]


def _of_no_age(c: Comparison) -> Finding:
  names, sensor = _names(c), _list(c.motion.compared)
  said = f"how late {sensor} is {UNJUDGED}: {names} are hardly alike in {c.motion.name} (correlation"
  where = "more alike seconds apart than within 0.5 s" if c.elsewhere else "at any lag within 0.5 s"
  text = f"{said} {c.correlation:.2f}), {where}; compare their clocks"
  return Finding("beware", (*c.motion.compared, *c.motion.reference), text)


def _say(c: Comparison) -> str:
  if c.correlation < _CONTRARY:
    return f"say the contrary of {c.motion.name}: one of them has the wrong sign"
  return f"do not agree in {c.motion.name} (correlation {c.whole:.2f})"


def _in_doubt(c: Comparison) -> bool:
  """Whether another reading of the channels may explain a motion better: as the log is read, the two are hardly alike.

  Of two slow motions some lag within the search makes any two sensors alike to a degree: over a minute of a full-size
  car up to 0.5. So a correlation alone says nothing until other readings were tested.
  """
  doubtful = c.whole < TIED if c.motion.kinematic else c.correlation < ALIKE
  return c.loud > _LOUD * c.levels[0] and doubtful


def _left(c: Comparison) -> float:
  """Share of the variance that the other sensor does not explain."""
  return 1.0 - c.whole**2


def _unrelated(c: Comparison, nominal: float) -> bool:
  """Whether two that have to agree do not, whatever their signs: by geometry always; otherwise where the compared
  sensor shows less than half of the motion, beyond three deviations.

  Least squares asks how much of the motion is in the sensor, so that what it feels besides does not count.
  """
  if c.motion.kinematic:
    return c.correlation >= _CONTRARY
  return (abs(c.felt.value) + 3.0 * c.felt.std) / nominal < 1.0 / FACTOR


def _cures(good: Sequence[tuple[Alternative, Comparison]]) -> str:
  """Every reading that makes the two agree, best first; which of them is right other sensors tell."""
  (best, comparison), *others = good
  also = "".join(f", or {other.cure} ({c.correlation:.3f})" for other, c in others)
  return f"they agree with {best.name} (correlation {comparison.correlation:.3f}); {best.cure}{also}"


def _far_apart(c: Comparison) -> str:
  if c.motion.acts:
    return _far_command(c)
  late, sensor = c.lag.value > 0.0, c.motion.compared[0]
  way = "late" if late else "early"
  behind = sensor if late else c.motion.reference[0]
  return (
    f"{sensor} is {abs(c.lag.value):.2f} ± {c.lag.std:.2f} s {way} against {_list(c.motion.reference)}: set late = "
    f"{abs(c.lag.value):.2f} on {behind} in [channels], or record both with one clock"
  )


def _far_command(c: Comparison) -> str:
  """Of a command and the answer to it: who commands has one clock for the drive, too."""
  late, command = _ANSWERS - c.lag.value, c.motion.reference[0]
  way = "before" if c.lag.value < 0.0 else "after"
  said = f"{c.motion.compared[0]} answers {command} {abs(c.lag.value):.2f} ± {c.lag.std:.2f} s {way} it"
  return (
    f"{said}, and cars answer about {_ANSWERS:g} s after it: set late = {late:.2f} on {command} in [channels], and on "
    "the drive's command where it has the same clock, or record all with one clock"
  )


def _not_in_time(c: Comparison, names: str) -> str:
  return (
    f"{names} have no common clock in {c.motion.name}: the lag between them was not found within 10 s; set late on one "
    "of them in [channels], or leave it out"
  )


def _odd(c: Comparison) -> list[Finding]:
  """Driving in which two that agree elsewhere part: a sensor that stuck, a place that was lost; of what geometry does
  not tie, also slip."""
  if c.odd == 0.0:
    return []
  channels = (*c.motion.compared, *c.motion.reference)
  spans = [f"{file} {start:.1f} s to {end:.1f} s" for file, start, end in c.where[:_LISTED]]
  named = ", ".join(spans) + (f" and {len(c.where) - _LISTED} more" if len(c.where) > _LISTED else "")
  said = f"in {c.odd:g} s of {c.seconds:g} s ({named}) {_list(channels)} do not agree in {c.motion.name} as elsewhere"
  cure = "cut those seconds out, or leave one of them out"
  if steered(c.motion):
    cure = "a slow servo, or tyres that slide, do that, and a fit can use it; if a sensor stuck, cut those seconds out"
  elif not {"yaw_rate", "accel_y", "pose_yaw"} & {*c.motion.compared}:  # wheels take part
    cure = f"wheels that spin or lock do that, and a fit can use it; if one of them stuck or was lost, {cure}"
  elif not c.motion.kinematic:
    cure = "a body that leans, or tyres that slide, do that, and a fit can use it; if one stuck, cut those seconds out"
  return [Finding("beware", channels, f"{said}; {cure}")]


def _off_zero(c: Comparison) -> list[Finding]:
  """A gyro or an accelerometer whose zero is further off than sensors of its kind are: three of the deviations that
  every fit gives it."""
  sensor = c.motion.compared[0]
  mechanism, parameter = _ZEROS.get(sensor, ("", ""))
  if not mechanism or abs(c.scale.value) < 1.0 / KNOTS or abs(c.scale.value) > KNOTS:
    return []
  usual = catalogue()[mechanism].sensor_errors[parameter].std
  if not (abs(c.bias.value) > _FAR * usual and c.bias.beyond(0.0)):
    return []
  said = f"{sensor} is {c.bias.value:+.3g} ± {c.bias.std:.2g} {c.motion.unit} off against {_list(c.motion.reference)}"
  tilted = ", or tilted" if sensor.startswith("accel") else ""
  cure = f"set offset = {-c.bias.value:.4g} on {sensor} in [channels], added to one that is there"
  return [Finding("beware", (sensor,), f"{said}, and usual are {usual:g}: its zero is off{tilted}; {cure}")]


def _off_scale(c: Comparison) -> list[Finding]:
  """Of two sensors that geometry ties: a scale."""
  if not c.scale.beyond(1.0) or abs(c.scale.value - 1.0) <= _SCALE:
    return []
  sensor = c.motion.compared[0]
  said = f"{sensor} reads {100 * (c.scale.value - 1.0):+.1f} ± {100 * c.scale.std:.1f} % against"
  what = "a scale, a gear ratio or a radius" if sensor in ("speed", "motor_speed") else "a scale"
  drifts = "pose_yaw" in c.motion.reference and c.motion.name != "turning"  # a rate knows no zero of a heading
  what += ", or the heading's zero," if drifts and c.scale.value > 1.0 else ""
  channels = (*c.motion.compared, *c.motion.reference)
  return [Finding("beware", channels, f"{said} {_list(c.motion.reference)}; {what} is off")]


def lag_findings(comparisons: Sequence[Comparison], wheelbase: float) -> list[Finding]:
  """Lags between sensors that geometry ties: one of the pose where all others are early against it, else of each.

  Wheels slip as the tyres push, which makes them look early; a gyro does not, so it says how late the pose is. Where
  none is told, an accelerometer says what is far too late for its sensor.
  """
  timed = {c.motion.name: c for c in comparisons if c.motion.kinematic and scaled(c) and not apart(c, wheelbase)}
  off = {name: c for name, c in timed.items() if c.lag.beyond(0.0) and abs(c.lag.value) > _PERIOD}
  if not off and (late := _felt_late(comparisons)) is not None:
    return [late]
  turning, driving = off.get("turning"), off.get("driving")
  if turning is None or driving is None or turning.lag.value * driving.lag.value < 0.0:
    return [_lag(c, 0.0 if name == "driving" and "turning" in timed else None) for name, c in off.items()]
  between = Estimate(driving.lag.value - turning.lag.value, math.hypot(driving.lag.std, turning.lag.std))
  both = [_together(turning, driving)] if abs(driving.lag.value) > abs(turning.lag.value) - 3.0 * between.std else []
  if both and not (between.beyond(0.0) and abs(between.value) > _PERIOD):
    return both
  return [*(both or [_lag(turning, None)]), _lag(dataclasses.replace(driving, lag=between), turning.lag.value)]


def _felt_late(comparisons: Sequence[Comparison]) -> Finding | None:
  """A speed that changes long after, or before, the accelerometer feels it, and what comes with that speed."""
  felt = next((c for c in comparisons if c.motion.name == "speeding up and slowing down"), None)
  if felt is None or not (abs(felt.lag.value) > _FELT_LATE and felt.lag.beyond(0.0) and felt.correlation > TIED):
    return None
  with_it = tuple(name for c in comparisons if c.motion.name == "driving" for name in c.motion.reference)
  sensors = felt.motion.compared if felt.lag.value > 0.0 else (*felt.motion.reference, *with_it)
  other = felt.motion.reference if felt.lag.value > 0.0 else felt.motion.compared
  said = (
    f"{_list(sensors)} {'is' if len(sensors) == 1 else 'are'} {abs(felt.lag.value):.2f} ± {felt.lag.std:.2f} s late"
  )
  cure = f"set late = {abs(felt.lag.value):.3f} on {'it' if len(sensors) == 1 else 'each of them'} in [channels]"
  return Finding("beware", (*sensors, *other), f"{said} against {_list(other)}: {cure}, or record both with one clock")


def _together(turning: Comparison, driving: Comparison) -> Finding:
  """What gyro and wheels are both compared with is late, or they are."""
  sensors = (*turning.motion.compared, *driving.motion.compared)
  pose = driving.motion.reference
  late, other = (sensors, pose) if turning.lag.value > 0.0 else (pose, sensors)
  size = abs(turning.lag.value)
  said = f"{_list(late)} are {1e3 * size:.0f} ± {1e3 * turning.lag.std:.0f} ms late against {_list(other)}"
  cure = f"set late = {size:.3f} on each of them in [channels]; start states and lags that are fitted depend on it"
  return Finding("beware", (*sensors, *pose), f"{said}: {cure}")


def _lag(c: Comparison, of_pose: float | None) -> Finding:
  """One sensor's lag. `of_pose`: the pose's by the gyro, s, which is not in this one; None without a gyro."""
  sensor, other = c.motion.compared[0], _list(c.motion.reference)
  another = "another " if of_pose else ""
  said = f"{sensor} is {another}{1e3 * abs(c.lag.value):.0f} ± {1e3 * c.lag.std:.0f} ms"
  said += f" {'late' if c.lag.value > 0 else 'early'} against {other}"
  if sensor in ("speed", "motor_speed") and c.lag.value < 0.0:
    slip = "the tyres slip as they push"
    said += (
      f": {slip}, since by the gyro the pose is not late by it"
      if of_pose is not None
      else (f": the pose is late, or {slip}, which looks the same")
    )
  elif sensor not in ("speed", "motor_speed"):  # nothing is early, so what is behind is late
    behind = sensor if c.lag.value > 0.0 else "pose_yaw, pose_x and pose_y"
    said += f": set late = {abs(c.lag.value):.3f} on {behind} in [channels]"
  text = f"{said}; start states and lags that are fitted depend on it"
  return Finding("beware", (*c.motion.compared, *c.motion.reference), text)


def _far_off(c: Comparison, nominal: float) -> list[Finding]:
  """Of an accelerometer, which also feels pitch and slip, or of what answers a command: a scale that is as far off as a
  unit's would be elsewhere."""
  share = c.scale.value / nominal
  if not scaled(c) or 1.0 / KNOTS < share < KNOTS:
    return []
  said = f"{_names(c)} differ {share:.2g}-fold in {c.motion.name}"
  cure = "a scale of one of them is off, or the clock: look at their units, and at time in [channels]"
  if "motor_speed" in c.motion.reference:
    cure += f", or [vehicle]: gear_ratio times wheel_radius would be {share:.3g} times as large; measure both"
  if steered(c.motion):
    slides = "its tyres, or an axle without a differential, push the car straight on, or " if share < 1.0 else ""
    cure = f"{slides}the scale of steering_command or the wheelbase is off: measure both"
  return [Finding("beware", (*c.motion.compared, *c.motion.reference), f"{said}: {cure}")]


def _names(c: Comparison) -> str:
  return f"{_list(c.motion.compared)} and {_list(c.motion.reference)}"


def _list(names: tuple[str, ...]) -> str:
  return " and ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} and {names[-1]}"
