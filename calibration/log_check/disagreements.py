"""What two sensors of one motion that disagree mean for a fit: a finding, with the cure that makes them agree."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Literal

from calibration.fitting.noise import ChannelNoise
from calibration.log_check.alternatives import agreeing
from calibration.log_check.motions import Wheels
from calibration.log_check.pairs import Comparison
from qcar_twin.recordings.recording import Recording

Severity = Literal["spoils", "beware", "note"]
_PERIOD = 0.01  # s, of the twin's control: a lag below it is no finding
_SCALE = 0.01  # a sensor's usual tolerance of sensitivity; a scale within it is no finding
_CONTRARY, _ALIKE = -0.5, 0.8  # correlation of two sensors of one motion: contrary, and alike enough to be scaled
_FACTOR = 2.0  # between two sensors of one motion, from which a unit or a gear is wrong
_KNOTS = 1.5  # the same where geometry ties them: a knot, 0.514 m/s, is the usual unit nearest to 1 m/s
_UNFELT = 0.3  # correlation below which an accelerometer or a gyro does not follow the car's motion at all
_TILTED = 0.5  # m/s^2, gravity at 3 degrees of tilt: an accelerometer has to follow motions stronger than that
_LOUD = 3.0  # times the compared sensor's noise that a motion must be for it to follow
_LATE = 0.5  # s, from which a lag is no sensor's or servo's, but of the log


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
) -> list[Finding]:
  """Findings about the two sensors of one motion, none where they agree or could not be compared.

  Args:
    c: their comparison.
    wheelbase: of the car, m; a steering command in rad turns it by speed / wheelbase.
    recordings, noise: what was compared, for trying other readings of the channels.
  """
  channels = (*c.motion.compared, *c.motion.reference)
  names = f"{_list(c.motion.compared)} and {_list(c.motion.reference)}"
  if c.why_not:
    return []
  spoils = lambda text: [Finding("spoils", channels, text)]
  if _unrelated(c):
    said = f"{names} do not agree in {c.motion.name} (correlation {c.correlation:.2f})"
    return spoils(f"{said}: {_cures(c, wheels, recordings, noise)}")
  if c.correlation < _CONTRARY:
    cure = _contrary_cure(c, wheels, recordings, noise)
    return spoils(f"{names} say the contrary of {c.motion.name}: one of them has the wrong sign; {cure}")
  if not math.isfinite(c.lag.value):
    return spoils(_not_in_time(c, names)) if c.motion.kinematic or c.correlation > _ALIKE else []
  if abs(c.lag.value) > _LATE:
    return spoils(_far_apart(c))
  expected = 1.0 / wheelbase if _steered(c) else 1.0
  scale, factor = c.scale.value / expected, _KNOTS if c.motion.kinematic else _FACTOR
  if c.correlation > _ALIKE and not 1.0 / factor < scale < factor:
    return spoils(f"{names} differ {scale:.3g}-fold in {c.motion.name}: {_scale_cure(c, wheelbase)}")
  return _small(c) if c.motion.kinematic else []


def _steered(c: Comparison) -> bool:
  return c.motion.reference[0] == "steering_command"


def _unrelated(c: Comparison) -> bool:
  """Whether two that have to agree do not: by geometry always; an accelerometer where it must feel the motion, a gyro
  where the car was steered."""
  if not c.loud > _LOUD * c.levels[0]:
    return False
  if c.motion.kinematic:
    return _CONTRARY <= c.correlation < _ALIKE
  strong = c.motion.unit != "m/s^2" or c.loud > _TILTED
  return strong and abs(c.correlation) < _UNFELT


def _cures(c: Comparison, wheels: Wheels, recordings: Sequence[Recording], noise: Mapping[str, ChannelNoise]) -> str:
  good, tried = agreeing(c.motion, wheels, recordings, noise)
  if not good:
    return f"one of them is another channel, or damaged; tried in vain: {', '.join(tried)}, another age of 10 s"
  (best, comparison), *others = good
  also = f", or {others[0][0].cure} ({others[0][1].correlation:.3f})" if others else ""
  return f"they agree with {best.name} (correlation {comparison.correlation:.3f}); {best.cure}{also}"


def _contrary_cure(
  c: Comparison, wheels: Wheels, recordings: Sequence[Recording], noise: Mapping[str, ChannelNoise]
) -> str:
  """Every reading that makes the two agree; which of them is right other sensors may tell."""
  good, _ = agreeing(c.motion, wheels, recordings, noise)
  return ", or ".join(alternative.cure for alternative, _ in good) or "set scale = -1 on it in [channels]"


def _scale_cure(c: Comparison, wheelbase: float) -> str:
  if not _steered(c):
    return "a unit, a gear ratio or a wheel radius is wrong; correct scale in [channels], or [vehicle]"
  return (
    f"the car turns like one of wheelbase {1.0 / c.scale.value:.3g} m, and [vehicle] says {wheelbase:.3g} m; correct "
    "cg_to_front and cg_to_rear in [vehicle], or the scale of steering_command or of what gives the speed in [channels]"
  )


def _far_apart(c: Comparison) -> str:
  late, sensor = c.lag.value > 0.0, c.motion.compared[0]
  way = "late" if late else "early"
  behind = sensor if late else c.motion.reference[0]
  return (
    f"{sensor} is {abs(c.lag.value):.2f} ± {c.lag.std:.2f} s {way} against {_list(c.motion.reference)}: set late = "
    f"{abs(c.lag.value):.2f} on {behind} in [channels], or record both with one clock"
  )


def _not_in_time(c: Comparison, names: str) -> str:
  return (
    f"{names} have no common clock in {c.motion.name}: the lag between them was not found within 10 s; set late on one "
    "of them in [channels], or leave it out"
  )


def _small(c: Comparison) -> list[Finding]:
  """Of two sensors that geometry ties: a lag, a scale, driving in which they part."""
  channels, findings = (*c.motion.compared, *c.motion.reference), []
  if c.odd > 0.0:
    said = f"in {c.odd:g} s of {c.seconds:g} s {_list(channels)} do not agree in {c.motion.name} as they do elsewhere"
    findings.append(Finding("beware", channels, f"{said}; cut those seconds out, or leave one of them out"))
  sensor, other = c.motion.compared[0], _list(c.motion.reference)
  if c.lag.beyond(0.0) and abs(c.lag.value) > _PERIOD:
    late = "late" if c.lag.value > 0.0 else "early"
    said = f"{sensor} is {1e3 * abs(c.lag.value):.0f} ± {1e3 * c.lag.std:.0f} ms {late} against {other}"
    findings.append(Finding("beware", channels, f"{said}; start states and lags that are fitted depend on it"))
  if c.scale.beyond(1.0) and abs(c.scale.value - 1.0) > _SCALE:
    said = f"{sensor} reads {100 * (c.scale.value - 1.0):+.1f} ± {100 * c.scale.std:.1f} % against {other}"
    findings.append(Finding("beware", channels, f"{said}; a scale, a gear ratio or a radius is off"))
  return findings


def _list(names: tuple[str, ...]) -> str:
  return " and ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} and {names[-1]}"
