"""Effects on the commands on their way to the car: what a generator has no parameter for."""

from __future__ import annotations

import numpy as np

from ..laboratory.manoeuvres import PERIOD
from .effects import Effect

_HUNTING = 2.7  # Hz
_DROPPED_EVERY = 2.0  # s


class _Delayed:
  """A delay line; between two control periods it gives their mean, weighed by the time that each acts."""

  def __init__(self, delay: float, channel: int) -> None:
    whole, self.part = divmod(delay / PERIOD, 1.0)
    self.line, self.channel = [0.0] * (int(whole) + 2), channel

  def __call__(self, drive: float, steer: float) -> tuple[float, float]:
    told = [drive, steer]
    self.line = [told[self.channel], *self.line[:-1]]
    told[self.channel] = (1.0 - self.part) * self.line[-2] + self.part * self.line[-1]
    return told[0], told[1]


class _Ramp:
  """First-order low pass of the drive command."""

  def __init__(self, memory: float) -> None:
    self.share, self.now = -np.expm1(-PERIOD / memory), 0.0

  def __call__(self, drive: float, steer: float) -> tuple[float, float]:
    self.now += self.share * (drive - self.now)
    return self.now, steer


class _Play:
  """The wheels are moved by whichever end of the play touches (Prandtl's play operator)."""

  def __init__(self, width: float) -> None:
    self.half, self.now = 0.5 * abs(width), 0.0

  def __call__(self, drive: float, steer: float) -> tuple[float, float]:
    self.now = min(max(self.now, steer - self.half), steer + self.half)
    return drive, self.now


class _Held:
  """The servo keeps its goal until the command is further away than the band, then takes it over."""

  def __init__(self, band: float) -> None:
    self.band, self.now = band, 0.0

  def __call__(self, drive: float, steer: float) -> tuple[float, float]:
    if abs(steer - self.now) > self.band:
      self.now = steer
    return drive, self.now


class _Hunting:
  """The servo swings about its goal."""

  def __init__(self, amplitude: float) -> None:
    self.amplitude, self.tick = amplitude, 0

  def __call__(self, drive: float, steer: float) -> tuple[float, float]:
    self.tick += 1
    return drive, steer + self.amplitude * float(np.sin(2.0 * np.pi * _HUNTING * PERIOD * self.tick))


class _Dropping:
  """The drive command is lost for a share of every two seconds."""

  def __init__(self, share: float) -> None:
    self.share, self.tick = share, 0

  def __call__(self, drive: float, steer: float) -> tuple[float, float]:
    phase = (self.tick * PERIOD / _DROPPED_EVERY) % 1.0
    self.tick += 1
    lost = min(max((self.share - phase) * _DROPPED_EVERY / PERIOD, 0.0), 1.0)  # of this period
    return (1.0 - lost) * drive, steer


COMMAND_EFFECTS: dict[str, Effect] = {
  "steering_dead_time": Effect(
    "steering", "command", ("steering_delay",), "s", 0.4, lambda size, full: _Delayed(size, 1)
  ),
  "steering_gain": Effect(
    "steering", "command", ("steering_gain_error",), "-", 0.5,
    lambda size, full: lambda drive, steer: (drive, (1.0 + size) * steer), signed=True,
  ),
  "steering_trim": Effect(
    "steering", "command", ("steering_offset",), "rad", 0.15,
    lambda size, full: lambda drive, steer: (drive, steer + size), signed=True,
  ),
  "steering_play": Effect("steering", "command", ("steering_backlash",), "rad", 0.3, lambda size, full: _Play(size)),
  "steering_band": Effect(
    "steering", "command", ("steering_quantisation",), "rad", 0.2, lambda size, full: _Held(size)
  ),
  "drive_dead_time": Effect("drive", "command", ("drive_delay",), "s", 0.5, lambda size, full: _Delayed(size, 0)),
  "drive_ramp": Effect("drive", "command", ("drive_lag",), "s", 0.6, lambda size, full: _Ramp(size)),
  "torque_steer": Effect(
    "steering", "command", (), "rad at full drive", 0.5,
    lambda size, full: lambda drive, steer: (drive, steer + size * drive / full), signed=True,
  ),
  "servo_hunting": Effect("steering", "command", (), "rad", 0.2, lambda size, full: _Hunting(size)),
  "drive_dropouts": Effect("drive", "command", (), "-", 0.5, lambda size, full: _Dropping(size)),
}  # fmt: skip
