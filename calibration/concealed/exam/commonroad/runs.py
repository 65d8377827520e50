"""Manoeuvres of a car that never stands and never reverses, at any size: stated at 1:10, stretched from there.

Steps and ramps of the wheel follow ISO 7401 and ISO 4138, lane changes ISO 3888, all at the speeds of a 1:10 car.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ...laboratory import manoeuvres as m
from ...laboratory.designs import in_two_halves
from ...laboratory.manoeuvres import DEGREE, Manoeuvre, Path

_PUSHES = {"identify": (6.0, -6.0, 9.0, -9.0, 4.0, -4.0), "validate": (8.0, -8.0, 5.0, -5.0)}  # A at 1:10
_PUSHED = 0.45  # s each


def rolling(rng: np.random.Generator, length: float, amperes: float) -> list[Manoeuvre]:
  """Thirteen recordings, 45 s at 1:10.

  Args:
    length: of the car over one at 1:10; times and speeds go by its root.
    amperes: current over that which accelerates a car at 1:10 alike.
  """
  runs = [
    *(_surges(levels, role, f"surges_{role}") for role, levels in _PUSHES.items()),
    _coast(2.4, 3.0, "identify"),
    _speeds(rng, 5.0, "identify"),
    *(
      m.steering_step(degrees, role, 2.5)
      for degrees, role in ((6.0, "identify"), (10.0, "identify"), (8.0, "validate"))
    ),
    m.ramp_steer(5.0, 0.9, 22.0, "identify", "ramp_steer"),
    m.chirp(1.4, 3.5, "identify", "chirp"),
    lane_changes(1.8, 4.0, "identify"),
    m.circles(1.8, 10.0, 4.0, "identify", "circles"),
    m.free_drive(rng, 5.0, "validate", "free_drive"),
    m.oval(1.2, 4.0, "holdout"),
  ]
  return in_two_halves([stretched(run, length, amperes) for run in runs])


def _surges(levels: Sequence[float], role: str, name: str) -> Manoeuvre:
  """Driving and braking torques of equal size in turn, from 2 m/s."""
  time = m.clock(_PUSHED * len(levels) + 0.5)
  index = np.clip((time - 0.5) / _PUSHED, 0, len(levels) - 1).astype(int)
  return m.open_loop(
    name, "pulses", role, np.where(time < 0.5, 0.0, np.array(levels)[index]), start=(0.0, 0.0, 0.0, 2.0)
  )


def _coast(speed: float, duration: float, role: str) -> Manoeuvre:
  """Rolling out."""
  return m.open_loop("coast_down", "coast_down", role, np.zeros(len(m.clock(duration))), start=(0.0, 0.0, 0.0, speed))


def _speeds(rng: np.random.Generator, duration: float, role: str) -> Manoeuvre:
  """Wished speeds that jump, none so low that the car could stop, with a little steering."""
  length = len(m.clock(duration))
  speed = m.held(rng, length, np.linspace(0.9, 2.4, 6), 0.8, 1.6)
  steer = m.smooth(m.held(rng, length, np.array([-8, -4, 0, 4, 8]) * DEGREE, 0.5, 1.2), 5)
  return m.at_speed("speed_changes", "speed_changes", role, speed, steer)


def lane_changes(speed: float, duration: float, role: str) -> Manoeuvre:
  """One period of a sine of the wheel to the left, and one to the right of another height."""
  time = m.clock(duration)
  part = 0.25 * duration
  wave = np.sin(2.0 * np.pi * (time % (2.0 * part) - 0.25 * part) / part)
  on = (time % (2.0 * part) > 0.25 * part) & (time % (2.0 * part) < 1.25 * part)
  steer = np.where(on, wave, 0.0) * np.where(time < 2.0 * part, 8.0, -12.0) * DEGREE
  return m.at_speed("lane_changes", "lane_change", role, np.full(time.shape, speed), steer, start=(0.0, 0.0, 0.0))


def stretched(run: Manoeuvre, length: float, amperes: float) -> Manoeuvre:
  """The manoeuvre of a car that is `length` times as long: times and speeds by its root, angles as they are."""
  slower = float(np.sqrt(length))
  at = np.arange(round(run.ticks * slower)) / slower
  index, ticks = np.minimum(at.astype(int), run.ticks - 1), np.arange(run.ticks)
  x, y, yaw, speed = run.start
  path = run.path and Path(length * run.path.x, length * run.path.y, run.path.yaw, run.path.curvature / length)
  return dataclasses.replace(
    run, steer=np.interp(at, ticks, run.steer), speed=slower * run.speed[index], volts=amperes * run.volts[index],
    start=(length * x, length * y, yaw, slower * speed), path=path,
  )  # fmt: skip
