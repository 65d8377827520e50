"""Which stretches of a long log to simulate: those that together tell most about a car; and recordings to leave out.

A car answers its commands and its speed; what it does not see of them no fit can find. So each stretch is described by
regressors that the laws of cars are made of (command, speed, drag, direction, steering, lateral acceleration, changes),
and stretches are chosen one at a time for the determinant of the information they add up to:

  next = argmax log det(M + G_s),   G_s = sum over the stretch of phi phi'

(D-optimal design, chosen greedily: Fedorov, Theory of Optimal Experiments, 1972). No car is simulated for it.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]
_PRIOR = 1e-3  # of the mean information of a stretch: what is known before the first
STANDING = 0.02  # of the largest speed of all recordings: a slower car does not move
MOST = 0.8  # of the time with a drive command


def regressors(commands: Array, speed: Array, heading: Array, period: float, spent: float) -> Array:
  """What a stretch excites, (T, 16), each in its own unit.

  Args:
    commands: drive and steering [rad], (T, 2).  speed: measured, m/s, (T,).
    heading: measured, rad, (T,); 0 where that is unknown.
    spent: command squared times s before it: heat and charge.
  """
  drive, steering = commands.T
  change = lambda v: np.gradient(v, period) if len(v) > 1 else np.zeros_like(v)
  forward, moving = np.sign(speed), np.abs(speed) > 1e-3
  turn, across = speed * steering, speed**2 * steering
  return np.stack(
    [drive, speed, speed * np.abs(speed), forward * moving, drive * speed, np.where(moving, 0.0, drive), change(speed),
     steering * moving, np.abs(steering) * moving, turn, across, across * np.abs(across), change(steering) * speed,
     forward * spent, np.cos(heading) * moving, np.sin(heading) * moving],
    axis=1,
  )  # fmt: skip


def chosen(stretches: Sequence[Array], room: int, already: Sequence[int] | NDArray[np.int64] = ()) -> NDArray[np.int64]:
  """Indices of so many stretches, in their order.

  Args:
    stretches: their regressors, (T_s, k) each.
    already: chosen for another reason; they count.
  """
  if room >= len(stretches):
    return np.arange(len(stretches))
  scale = np.sqrt(np.mean(np.concatenate([s**2 for s in stretches]), axis=0))
  shown = np.stack([s.T @ s for s in (s / np.where(scale > 0.0, scale, 1.0) for s in stretches)])
  known = _PRIOR * np.trace(shown.mean(axis=0)) / shown.shape[1] * np.eye(shown.shape[1])
  taken = [int(i) for i in already]
  known = known + shown[taken].sum(axis=0)
  left = [i for i in range(len(stretches)) if i not in taken]
  for _ in range(room - len(taken)):
    best = left[int(np.argmax(np.linalg.slogdet(known + shown[left])[1]))]
    known = known + shown[best]
    left.remove(best)
    taken.append(best)
  return np.sort(np.array(taken, dtype=np.int64))


def split_standing(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
  """Recordings to fit, and the names of those in which the car stands for most of the time that it is driven.

  Static friction holds it. They bound that, and say nothing about the friction of a car that rolls.
  """
  fastest = {name: max((_peak(r, name) for r in recordings), default=0.0) for name in ("motor_speed", "speed")}
  held = [r.name for r in recordings if _share(r, fastest) > MOST]
  return [r for r in recordings if r.name not in held], held


def _peak(recording: Recording, channel: str) -> float:
  return float(np.quantile(np.abs(recording[channel].value), 0.99)) if channel in recording else 0.0


def _share(recording: Recording, fastest: dict[str, float]) -> float:
  """Share of the time with a drive command in which the car does not move; 0 if there is no command at all."""
  channel = next((name for name in fastest if name in recording), None)
  if channel is None:
    return 0.0
  time, commands = recording.commands(0.02)
  driven = np.abs(commands[:, 0]) > 1e-6
  stream = recording[channel]
  slow = np.abs(np.interp(time, stream.time, stream.value)) < STANDING * fastest[channel]
  return float(np.mean(slow[driven])) if driven.any() else 0.0
