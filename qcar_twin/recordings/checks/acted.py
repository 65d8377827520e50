"""Did the commands act as they were logged?

With the numbers below no sound drive is blamed and none of the false ones is passed; how far each could be moved is
measured by `python -m tests.faults.thresholds`.

The neutral of a drive or a servo, stretches in which a command did nothing, a commanded speed in the measured one's
place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.checks.faults import Runs
from qcar_twin.recordings.recording import Recording

_PERIOD = 0.05  # s, of the grid on which commands and motion are compared
MOVING, _SLOWS = 0.2, 0.1  # of the top speed: from which the car drives, and so much less in a second is slowing down
_RESTS = 0.03  # of the usual top speed, below which the car stands
_ANSWERS = 0.5  # s, within which a car that stands has answered a command; no drive's lag is longer
_LEAST_REST = 2.0  # s at rest that tell a neutral; of driving: a sign
_LEAST_IDLE = 2.0  # s in a row of a command that does nothing
_NEAR = 0.02  # of the command's range: one level
_MOST = 0.25  # share of the rest that a neutral has; commands too small to break the car away take the others
_NEVER = 0.5  # of the largest command: what stays beyond it never comes near 0
_CONTRARY = 0.8  # share of the steady driving under a command of the other sign
_OFF = 0.1  # of the command's range, beyond which a neutral is not 0
_RARE = 0.05  # share of the driving that a level may take part in and still not drive the car
_WEAK = 25.0  # per cent of the steady driving that happens under less: a command below it may not move a car from rest
_BIN = 0.25  # s, over which turning is compared with steering
_GENTLE = 4.0  # m/s^2 across, below which the turning is proportional to the angle
_CENTRED = 0.35  # of the largest steering command, within which a straight-ahead is a trim; usual ones are up to 0.25
_SURE = 0.05  # of the largest steering command: standard deviation of a straight-ahead that says anything
_STAYS = 0.4  # s, median, for which a commanded value stays
_SLOWEST = 1.0  # s: no sensor of speed is slower
_LEAST_STEPS, _SAMPLES = 3, 5  # steps that tell, and samples, median, for which a value stays then
# of the top speed: above the quantum of a coarse sensor, a twelfth, below a usual step of command, a sixth
_LEAP = 0.12
_PAST, _ROUNDING = 1.5, 1e-9  # quanta, from which a step is past the neighbour; of the top speed, digits that are noise


@dataclass(frozen=True)
class Neutral:
  """The value of a command with which the car stands or goes straight on, in the channel's unit, and why."""

  channel: str
  value: float
  why: str


@dataclass(frozen=True)
class Idle:
  """A stretch of a recording, s, in which the drive's command was as large as when it drove the car, which stood."""

  recording: Recording
  channel: str
  start: float
  end: float


@dataclass(frozen=True)
class _Drive:
  """Command and speed on a grid, (k,), whether the car stands, and whether it has answered the command by then."""

  time: np.ndarray
  command: np.ndarray
  speed: np.ndarray
  stands: np.ndarray
  rest: np.ndarray


def drive_neutral(recordings: Sequence[Recording], channel: str) -> Neutral | None:
  """The level that the drive's command has while the car stands, where it is not 0 and never keeps the car going.

  A neutral is the commonest level at rest, under which a moving car only slows down. A command that was not passed on
  has levels that drive the car elsewhere.
  """
  held = [d for r in recordings if (d := _drive(r, channel)) is not None]
  if not held:
    return None
  rest = np.concatenate([d.command[d.rest] for d in held])
  span = _span(held)
  if rest.size * _PERIOD < _LEAST_REST or span == 0.0:
    return None
  level = _commonest(rest, _NEAR * span)
  near = lambda command: np.abs(command - level) < _NEAR * span
  zero = np.mean(np.abs(rest) < _NEAR * span)
  if np.mean(near(rest)) < _MOST or zero > _RARE or abs(level) < _OFF * span:
    return None
  if _keeps_going(held, near) > _RARE:
    return None
  said = f"the car stands under {level:.4g}, for {rest.size * _PERIOD:.0f} s, and never drives on under it"
  return Neutral(channel, level, said)


def _commonest(values: np.ndarray, width: float) -> float:
  """Median of the values that lie within `width` of most others."""
  ordered = np.sort(values)
  last = np.searchsorted(ordered, ordered + 2.0 * width, side="right")
  first = int(np.argmax(last - np.arange(ordered.size)))
  return float(np.median(ordered[first : last[first]]))


def least_command(recordings: Sequence[Recording], channel: str) -> float | None:
  """The command nearest to 0, where the car stood for a while and nothing near 0 was ever commanded, else None.

  Whether that is a neutral or commands too small to move the car, only a person knows.
  """
  held = [d for r in recordings if (d := _drive(r, channel)) is not None]
  command = np.concatenate([d.command for d in held]) if held else np.empty(0)
  if sum(int(d.stands.sum()) for d in held) * _PERIOD < _LEAST_REST or not command.size:
    return None
  least = float(command[np.argmin(np.abs(command))])
  return least if abs(least) > _NEVER * float(np.abs(command).max()) else None


def switched_command(recordings: Sequence[Recording], channel: str) -> float | None:
  """The command nearest to 0 but 0 itself, where the car stood for a while under others than 0, and the way from 0 to
  it is longer than any other between two commands: a neutral, under a switch that makes a 0 of it."""
  held = [d for r in recordings if (d := _drive(r, channel)) is not None]
  command = np.concatenate([d.command for d in held]) if held else np.empty(0)
  resting = sum(int(np.sum(d.rest & (d.command != 0.0))) for d in held) * _PERIOD
  if resting < _LEAST_REST:
    return None
  given = np.unique(command[command != 0.0])
  least = float(given[np.argmin(np.abs(given))])
  one_sided = given[0] > 0.0 or given[-1] < 0.0
  return least if one_sided and abs(least) > float(np.max(np.diff(given), initial=0.0)) else None


def _span(held: Sequence[_Drive]) -> float:
  low, high = np.percentile(np.concatenate([d.command for d in held]), [1, 99])
  return float(high - low)


def _keeps_going(held: Sequence[_Drive], near: Callable[[np.ndarray], np.ndarray]) -> float:
  """Share of the steady driving that happens under commands that are `near`."""
  steady = [_steady(d) for d in held]
  driven = sum(int(s.sum()) for s in steady)
  under = sum(int(np.sum(s & near(d.command))) for d, s in zip(held, steady, strict=True))
  return under / driven if driven else 1.0


def _steady(d: _Drive) -> np.ndarray:
  """Where the car moves and does not slow down."""
  top = float(np.percentile(np.abs(d.speed), 99.0))
  speed = np.convolve(np.abs(d.speed), np.full(5, 0.2), "same")
  return (speed > MOVING * top) & (np.gradient(speed, _PERIOD) > -_SLOWS * top)


def idle_stretches(recordings: Sequence[Recording], channel: str, neutral: float = 0.0) -> list[Idle]:
  """Stretches in which the car stood under commands that drive it elsewhere: a switch that was released, a stop by
  hand, an encoder that stuck. `neutral`: the command's value at rest."""
  held = [(r, d) for r in recordings if (d := _drive(r, channel)) is not None]
  steady = np.concatenate([np.abs(d.command - neutral)[_steady(d)] for _, d in held]) if held else np.empty(0)
  if not steady.size:
    return []
  least = max(float(np.percentile(steady, _WEAK)), np.finfo(float).tiny)
  return [
    Idle(recording, channel, float(d.time[first]), float(d.time[last]))
    for recording, d in held
    for first, last, idle in _runs(d.stands & (np.abs(d.command - neutral) >= least))
    if idle and (last - first) * _PERIOD >= _LEAST_IDLE
  ]


def against(recordings: Sequence[Recording], channel: str) -> bool:
  """Whether the car goes backwards under commands that are positive, and forwards under negative ones."""
  held = [d for r in recordings if (d := _drive(r, channel)) is not None]
  steady = [_steady(d) & (d.command != 0.0) for d in held]
  signs = [np.sign(d.command[s] * d.speed[s]) for d, s in zip(held, steady, strict=True)]
  count = sum(map(len, signs))
  return count * _PERIOD >= _LEAST_REST and float(np.sum(np.concatenate(signs) < 0.0)) > _CONTRARY * count


def _drive(recording: Recording, channel: str) -> _Drive | None:
  name = "motor_speed" if "motor_speed" in recording else "speed"
  if channel not in recording or name not in recording or len(recording[name]) < 2:
    return None
  if channel in recording.derived:
    return None
  time, commands = recording.commands(_PERIOD, (channel,))
  stream = recording[name]
  speed = np.interp(time, stream.time, stream.value)
  top = float(np.percentile(np.abs(speed), 99.0))
  stands = np.abs(speed) < _RESTS * top
  count, rest = int(_ANSWERS / _PERIOD), np.zeros(time.size, dtype=bool)
  for first, last, value in _runs(stands):
    if value:
      rest[first + count : last + 1 - count] = True
  return _Drive(time, commands[:, 0], speed, stands, rest)


def _runs(mask: np.ndarray) -> list[tuple[int, int, bool]]:
  runs = Runs.of(mask.astype(float))
  return [(int(a), int(b), bool(v)) for a, b, v in zip(runs.first, runs.last, runs.value, strict=True)]


def steering_neutral(recordings: Sequence[Recording]) -> Neutral | None:
  """The steering command with which the car goes straight on, where it is so far from 0 that it is no trim.

  Least squares of yaw rate = a v command + b v in bins, gentle driving only: straight ahead at -b / a.
  """
  rows = [part for r in recordings if (part := _turning(r)) is not None]
  if not rows:
    return None
  speed, command, turning = np.concatenate(rows, axis=1)
  top = float(np.percentile(np.abs(command), 99.0)) if command.size else 0.0
  if command.size < 20 or top == 0.0:
    return None
  design = np.stack([speed * command, speed], axis=1)
  (slope, offset), squares, rank, _ = np.linalg.lstsq(design, turning, rcond=None)
  if rank < 2 or slope == 0.0 or not squares.size:
    return None
  straight = -offset / slope
  covariance = np.linalg.inv(design.T @ design) * float(squares[0]) / (command.size - 2)
  gradient = np.array([offset / slope**2, -1.0 / slope])
  spread = float(np.sqrt(gradient @ covariance @ gradient))
  low, high = np.percentile(command, [1, 99])
  if not (abs(straight) > _CENTRED * top and low < straight < high and spread < _SURE * top):
    return None
  return Neutral("steering_command", float(straight), f"the car goes straight on under {straight:.4g}")


def _turning(recording: Recording) -> np.ndarray | None:
  """Speed, steering command and yaw rate in bins where the car turns gently, (3, k)."""
  name = "motor_speed" if "motor_speed" in recording else "speed"
  if "steering_command" not in recording or name not in recording:
    return None
  edges = recording.start + _BIN * np.arange(int(recording.duration / _BIN) + 1)
  middle = 0.5 * (edges[1:] + edges[:-1])
  if middle.size == 0:
    return None
  if "yaw_rate" in recording:
    turning = recording["yaw_rate"].interpolate(middle)
  elif "pose_yaw" in recording:
    turning = np.diff(recording["pose_yaw"].interpolate(edges)) / _BIN
  else:
    return None
  speed, command = recording[name].interpolate(middle), recording["steering_command"].at(middle)
  there = np.isfinite(turning) & np.isfinite(speed) & (np.abs(speed) > 0.0)
  if name == "speed":
    there &= np.abs(speed * turning) < _GENTLE
  return np.stack([speed, command, turning])[:, there]


def was_commanded(recordings: Sequence[Recording], channel: str) -> bool:
  """Whether a measured speed stays for long and leaps: it is what was commanded.

  A sensor that publishes slowly has much the same time between its values, and less than a second. A coarse one that
  stays goes on to the neighbouring step, what is commanded past it.
  """
  stays, samples, leaps, top = [np.empty(0)], [np.empty(0)], [np.empty(0)], 0.0
  for stream in (r[channel] for r in recordings if channel in r and len(r[channel]) > 2):
    runs, step = Runs.of(stream.value), float(np.median(np.diff(stream.time)))
    samples.append(runs.length[1:-1].astype(float))
    stays.append(step * samples[-1])
    leaps.append(np.abs(np.diff(runs.value)))
    top = max(top, float(np.percentile(np.abs(stream.value), 99.0)))
  seconds = np.concatenate(stays)
  if seconds.size < _LEAST_STEPS:
    return False
  low, usual, high = np.percentile(seconds, [25, 50, 75])
  uneven = np.median(np.concatenate(samples)) >= _SAMPLES and high - low > 0.5 * usual
  long = usual > _SLOWEST or (usual > _STAYS and uneven)
  leap = float(np.median(np.concatenate(leaps)))
  return bool(long and (leap > _LEAP * top or leap > _PAST * _quantum(recordings, channel, top)))


def _quantum(recordings: Sequence[Recording], channel: str, top: float) -> float:
  """The smallest step between two values that a channel has."""
  values = np.concatenate([r[channel].value for r in recordings if channel in r])
  steps = np.diff(np.unique(values))
  return float(np.min(steps[steps > _ROUNDING * top], initial=np.inf))
