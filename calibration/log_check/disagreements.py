"""What two sensors of one motion that disagree mean for a fit: a finding, with the cure that makes them agree."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Literal

from calibration.fitting.noise import ChannelNoise
from calibration.log_check.alternatives import Alternative, agreeing
from calibration.log_check.motions import Wheels
from calibration.log_check.pairs import Comparison
from qcar_twin.recordings.recording import Recording

Severity = Literal["spoils", "beware", "note"]
_PERIOD = 0.01  # s, of the twin's control: a lag below it is no finding
_SCALE = 0.01  # a sensor's usual tolerance of sensitivity; a scale within it is no finding
_CONTRARY, _ALIKE = -0.5, 0.8  # correlation of two sensors of one motion: contrary, and alike enough to be scaled
_FACTOR = 2.0  # between two sensors of one motion, from which a unit or a gear is wrong
_KNOTS = 1.5  # the same where geometry ties them: a knot, 0.514 m/s, is the usual unit nearest to 1 m/s
_LOUD = 3.0  # times the compared sensor's noise that a motion must be for the two to be alike
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
  if c.why_not:
    return []
  channels = (*c.motion.compared, *c.motion.reference)
  names = _names(c)
  expected = 1.0 / wheelbase if _steered(c) else 1.0
  spoils = lambda text: [Finding("spoils", channels, text)]
  if _in_doubt(c):
    good, tried = agreeing(c.motion, wheels, recordings, noise)
    if good:
      return spoils(f"{names} {_say(c)}: {_cures(good)}")
    if _unrelated(c, expected):
      return spoils(
        f"{names} {_say(c)}: one of them is another channel, or damaged; tried in vain: {', '.join(tried)}, another "
        "age of 10 s"
      )
  if c.correlation < _CONTRARY:
    return spoils(f"{names} {_say(c)}; set scale = -1 on it in [channels]")
  if c.correlation <= _ALIKE and not c.motion.kinematic:
    return _hardly_alike(c, expected, wheelbase)
  if not math.isfinite(c.lag.value):
    return spoils(_not_in_time(c, names))
  if abs(c.lag.value) > _LATE:
    return spoils(_far_apart(c))
  scale, factor = c.scale.value / expected, _KNOTS if c.motion.kinematic else _FACTOR
  if c.correlation > _ALIKE and not 1.0 / factor < scale < factor:
    return spoils(f"{names} differ {scale:.3g}-fold in {c.motion.name}: {_scale_cure(c, wheelbase)}")
  return _small(c) if c.motion.kinematic else []


def _hardly_alike(c: Comparison, expected: float, wheelbase: float) -> list[Finding]:
  """Of two that are not contrary and that noise, slip or tilt part: a scale beyond three deviations, or that this
  driving says nothing of them."""
  channels = (*c.motion.compared, *c.motion.reference)
  felt, spread = c.felt.value / expected, 3.0 * c.felt.std / expected
  if felt - spread > _FACTOR:
    said = f"{_names(c)} differ {felt:.3g}-fold in {c.motion.name}: {_scale_cure(c, wheelbase)}"
    return [Finding("spoils", channels, said)]
  if felt - spread > 0.0 or not c.loud > _LOUD * c.levels[0]:
    return []
  said = f"whether {_list(c.motion.compared)} shows {c.motion.name} cannot be told from this driving"
  cure = "look at its axis and sign, or drive longer"
  return [
    Finding("beware", channels, f"{said} (correlation {c.correlation:.2f} with {_list(c.motion.reference)}); {cure}")
  ]


def _names(c: Comparison) -> str:
  return f"{_list(c.motion.compared)} and {_list(c.motion.reference)}"


def _steered(c: Comparison) -> bool:
  return c.motion.reference[0] == "steering_command"


def _say(c: Comparison) -> str:
  if c.correlation < _CONTRARY:
    return f"say the contrary of {c.motion.name}: one of them has the wrong sign"
  return f"do not agree in {c.motion.name} (correlation {c.correlation:.2f})"


def _in_doubt(c: Comparison) -> bool:
  """Whether another reading of the channels may explain a motion better: as the log is read, the two are hardly alike.

  Of two slow motions some lag within the search makes any two sensors alike to a degree: over a minute of a full-size
  car up to 0.5. So a correlation alone says nothing until other readings were asked.
  """
  return c.loud > _LOUD * c.levels[0] and c.correlation < _ALIKE


def _unrelated(c: Comparison, expected: float) -> bool:
  """Whether two that have to agree do not, whatever their signs: by geometry always; otherwise where the compared
  sensor shows less than half of the motion, beyond three deviations.

  Least squares asks how much of the motion is in the sensor, so that what it feels besides does not count.
  """
  if c.motion.kinematic:
    return c.correlation >= _CONTRARY
  felt = c.felt.value / expected
  return abs(felt) + 3.0 * c.felt.std / expected < 1.0 / _FACTOR


def _cures(good: Sequence[tuple[Alternative, Comparison]]) -> str:
  """Every reading that makes the two agree, best first; which of them is right other sensors tell."""
  (best, comparison), *others = good
  also = "".join(f", or {other.cure} ({c.correlation:.3f})" for other, c in others)
  return f"they agree with {best.name} (correlation {comparison.correlation:.3f}); {best.cure}{also}"


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
