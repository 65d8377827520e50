"""Did the commands act as they were logged?

With the numbers below no sound drive is blamed and none of the false ones is passed; how far each could be moved is
measured by `python -m tests.faults.thresholds`.

Stretches in which a command did nothing, a command of the other sign, a commanded speed in the measured one's place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.checks.driving import LEAST_REST, MOVING, PERIOD, Drive, driven, runs, steady
from qcar_twin.recordings.checks.faults import Runs, stuck_speeds
from qcar_twin.recordings.checks.signs import turned_back
from qcar_twin.recordings.recording import Recording

# share of the driving: one sample in twenty that no model can explain outweighs the noise of the rest; how far it could
# be moved `python -m tests.faults.thresholds` measures
MUCH = 0.05
_CONTRARY = 0.8  # share of the steady driving under a command of the other sign
OFF = 0.1  # of the commands that drive, below which a controller takes one for none
_LEAST_IDLE = 2.0  # s in a row of a command that does nothing
WEAK = 25.0  # per cent of the steady driving that happens under less: a command below it may not move a car from rest
_LONGEST_LAG = 0.5  # s, for which a drive may go on after its command was reversed
_STAYS = 0.4  # s, median, for which a commanded value stays
_SLOWEST = 1.0  # s: no sensor of speed is slower
_LEAST_STEPS, _SAMPLES = 3, 5  # steps that tell, and samples, median, for which a value stays then
# of the top speed: above the quantum of a coarse sensor, a twelfth, below a usual step of command, a sixth
_LEAP = 0.12
_PAST, _ROUNDING = 1.5, 1e-9  # quanta, from which a step is past the neighbour; of the top speed, digits that are noise


@dataclass(frozen=True)
class Stretch:
  """A stretch of a recording, s, in which command and speed do not go together."""

  recording: Recording
  channel: str
  start: float
  end: float


def idle_stretches(recordings: Sequence[Recording], channel: str, neutral: float = 0.0) -> list[Stretch]:
  """Stretches in which the car stood under commands that drive it elsewhere: a switch that was released, a stop by
  hand, an encoder that stuck. `neutral`: the command's value at rest."""
  held = driven(recordings, channel)
  driving = np.concatenate([np.abs(d.command - neutral)[steady(d)] for d in held]) if held else np.empty(0)
  if not driving.size:
    return []
  least = max(float(np.percentile(driving, WEAK)), np.finfo(float).tiny)
  return [
    Stretch(d.recording, channel, float(d.time[first]), float(d.time[last]))
    for d, brakes in zip(held, braked(held, channel, neutral), strict=True)
    for first, last, idle in runs(d.stands & (np.abs(d.command - neutral) >= least) & ~brakes)
    if idle and (last - first) * PERIOD >= _LEAST_IDLE
  ]


def braked(held: Sequence[Drive], channel: str, neutral: float = 0.0) -> list[np.ndarray]:
  """Where a duty backwards brakes, (k,) of each drive (mechanism drive_one_way, which every fit has).

  Told while the car goes forwards it brakes, and holds the car when it stands, until it was told neutral. A controller
  that no such duty ever drove backwards has no reverse, and brakes a car that stands, too, if that drives on later.
  """
  if channel != "motor_duty":
    return [np.zeros(drive.command.size, dtype=bool) for drive in held]
  off = [-OFF * float(np.abs(drive.command - neutral).max(initial=0.0)) for drive in held]
  back = [drive.command - neutral < least for drive, least in zip(held, off, strict=True)]
  forwards = [~drive.stands & (drive.speed > 0.0) for drive in held]
  backwards = [~drive.stands & (drive.speed < 0.0) & told for drive, told in zip(held, back, strict=True)]
  reverses, masks = any(mask.any() for mask in backwards), [np.zeros(told.size, dtype=bool) for told in back]
  for goes, told, mask in zip(forwards, back, masks, strict=True):
    for first, last, against_ in runs(told):
      mask[first : last + 1] = against_ and bool(goes[first] or (not reverses and goes[last + 1 :].any()))
  return masks


def against(recordings: Sequence[Recording], channel: str) -> bool:
  """Whether the car goes backwards under commands that are positive, and forwards under negative ones."""
  held = driven(recordings, channel)
  driving = [steady(d) & (d.command != 0.0) for d in held]
  signs = [np.sign(d.command[s] * d.speed[s]) for d, s in zip(held, driving, strict=True)]
  count = sum(map(len, signs))
  return count * PERIOD >= LEAST_REST and float(np.sum(np.concatenate(signs) < 0.0)) > _CONTRARY * count


def lost_sign(recordings: Sequence[Recording], channel: str) -> list[Stretch]:
  """Stretches in which the car was driven backwards, though its speed is never negative: the sensor counts without a
  sign. It drives on under a command of the other sign, for more of the time than noise and odd seconds take, or the
  steering shows it; none where neither does."""
  held = driven(recordings, channel)
  top = max((float(np.percentile(np.abs(d.speed), 99.0)) for d in held), default=0.0)
  if any(float(np.percentile(d.speed, 1.0)) < -MOVING * top for d in held):
    return []
  lost = _driven_on(held, channel)
  if sum(stretch.end - stretch.start for stretch in lost) > MUCH * sum(r.duration for r in recordings):
    return lost
  return [Stretch(recording, channel, start, end) for recording, start, end in turned_back(held)]


def _driven_on(held: Sequence[Drive], channel: str) -> list[Stretch]:
  """Where the car drives on under a negative command. One that is braked by such a command slows down."""
  large = float(np.percentile(np.abs(np.concatenate([d.command for d in held])), WEAK)) if held else 0.0
  return [
    Stretch(d.recording, channel, float(d.time[first]), float(d.time[last]))
    for d in held
    for first, last, reversed_ in runs(steady(d) & (d.command < -large) & ~_stuck(d))
    if reversed_ and (last - first) * PERIOD >= _LONGEST_LAG
  ]


def _stuck(drive: Drive) -> np.ndarray:
  """Where the measured speed stuck and tells nothing, (k,)."""
  out = np.zeros(drive.time.size, dtype=bool)
  for start, end in stuck_speeds(drive.recording):
    out |= (drive.time >= start) & (drive.time <= end)
  return out


def was_commanded(recordings: Sequence[Recording], channel: str) -> bool:
  """Whether a measured speed stays for long and leaps: it is what was commanded.

  A sensor that publishes slowly has much the same time between its values, and less than a second. A coarse one that
  stays goes on to the neighbouring step, what is commanded past it. Of a few levels further apart than any sensor's
  steps, as a driver with discrete actions chooses among, it need not stay.
  """
  stays, samples, leaps, top = [np.empty(0)], [np.empty(0)], [np.empty(0)], 0.0
  for stream in (r[channel] for r in recordings if channel in r and len(r[channel]) > 2):
    held, step = Runs.of(stream.value), float(np.median(np.diff(stream.time)))
    samples.append(held.length[1:-1].astype(float))
    stays.append(step * samples[-1])
    leaps.append(np.abs(np.diff(held.value)))
    top = max(top, float(np.percentile(np.abs(stream.value), 99.0)))
  seconds = np.concatenate(stays)
  if seconds.size < _LEAST_STEPS:
    return False
  low, usual, high = np.percentile(seconds, [25, 50, 75])
  uneven = np.median(np.concatenate(samples)) >= _SAMPLES and high - low > 0.5 * usual
  long = usual > _SLOWEST or (usual > _STAYS and uneven)
  leap, quantum = float(np.median(np.concatenate(leaps))), _quantum(recordings, channel, top)
  return bool(_LEAP * top < quantum < np.inf or (long and (leap > _LEAP * top or leap > _PAST * quantum)))


def _quantum(recordings: Sequence[Recording], channel: str, top: float) -> float:
  """The smallest step between two values that a channel has."""
  values = np.concatenate([r[channel].value for r in recordings if channel in r])
  steps = np.diff(np.unique(values))
  return float(np.min(steps[steps > _ROUNDING * top], initial=np.inf))
