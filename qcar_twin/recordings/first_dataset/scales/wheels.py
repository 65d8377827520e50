"""Wheels' speeds whose names say no unit: rad/s or rpm of the wheel, or a speed over ground.

A wheel of radius R that turns at w rolls at w R. What the car did is told by a place, else by both accelerometers:
along d(speed)/dt, across speed times yaw rate.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.recordings.checks.units import UNIT_CORRELATION, compare
from qcar_twin.recordings.first_dataset.columns import Columns, Guess, scale
from qcar_twin.recordings.first_dataset.refine import recordings_of
from qcar_twin.recordings.formats.axles import of_wheels
from qcar_twin.recordings.recording import Recording
from qcar_twin.recordings.unit_names import UNITS, unit_of, words_of
from qcar_twin.vehicle.vehicle import Vehicle

_TURNS, _OVER_GROUND = ("rad/s", "rpm"), ("m/s", "km/h", "cm/s", "mm/s")
_NEAR = 1.6  # of what other sensors show: the radius is a guess of 30 %, and accelerometers feel tilt and slip
_SPEEDS = {"speed", "speeds", "spd", "vel", "velocity", "v"}
_FELT = ("accel_x", "accel_y")
_IN_G = 2.0  # the largest reading, up to which an accelerometer may be in g; then rpm looks like rad/s


def settle_wheels(columns: Columns, guesses: dict[str, Guess], vehicle: Vehicle) -> list[str]:
  """Read a wheel's speed without a unit in the one that other sensors show; one that turns becomes the motor's by the
  gear ratio. Returns a question where nothing shows it, or two units may be meant.

  Args:
    vehicle: whose wheel radius, m, and gear ratio are taken.
  """
  guess = guesses.get("speed")
  if guess is None or "motor_speed" in guesses or unit_of(guess.column) is not None or not of_wheels(guess.column):
    return []
  metres = {unit: UNITS[unit][1] * vehicle.wheel_radius for unit in _TURNS} | {u: UNITS[u][1] for u in _OVER_GROUND}
  off = _off(columns, guesses, metres)
  near = sorted((unit for unit in metres if off[unit] < math.log(_NEAR)), key=lambda unit: off[unit])
  if len(near) != 1 and _SPEEDS & set(words_of(guess.column)):
    return []  # what is called a speed is one over ground, unless other sensors show it
  if len(near) != 1:
    units = " or ".join(near or metres)
    return [
      f"'{guess.column}' is a wheel's speed and names no unit, and the log does not tell whether it is in {units}: for "
      f"rad/s set scale = {metres['rad/s']:.4g} on speed, the wheel's radius in m; for rpm {metres['rpm']:.4g}"
    ]
  by_size = Guess("speed", guess.column)
  scale(columns, by_size)
  guess.why = [said for said in guess.why if said not in by_size.why]
  why = f"other sensors show the same motion in {near[0]}"
  if near[0] in _OVER_GROUND:
    guess.scale, guess.offset, guess.named = UNITS[near[0]][1], 0.0, True
    guess.why.append(why)
    return []
  del guesses["speed"]
  turned = [*guess.why, f"{why} of a wheel, which a motor turns by gear_ratio = {vehicle.gear_ratio:g}: correct both"]
  factor = UNITS[near[0]][1] / vehicle.gear_ratio
  guesses["motor_speed"] = Guess("motor_speed", guess.column, factor, hold=guess.hold, named=True, why=turned)
  return []


def _off(columns: Columns, guesses: Mapping[str, Guess], metres: Mapping[str, float]) -> dict[str, float]:
  """By unit how far the column is, so read, from what the place shows, else from what both accelerometers show: the
  size of the logarithm, the larger of two; inf where nothing shows it.

  Args:
    metres: by unit the speed over ground, m/s, for 1 of the column.
  """
  others = {name: g for name, g in guesses.items() if name not in ("speed", "pose_yaw")}  # whose unit comes later
  for name in _FELT:
    if name in others and not others[name].named and abs(others[name].scale) * columns.top(others[name].column) < _IN_G:
      del others[name]
  raw = Guess("speed", guesses["speed"].column, hold=guesses["speed"].hold)
  off = {}
  for unit, metre in metres.items():
    slopes = _slopes(recordings_of(columns, {**others, "speed": dataclasses.replace(raw, scale=metre)}))
    by = [slopes["speed"]] if "speed" in slopes else [slopes.get(name, math.inf) for name in _FELT]
    off[unit] = max(abs(math.log(slope)) for slope in by)
  return off


def _slopes(recordings: Sequence[Recording]) -> dict[str, float]:
  """By the compared channel its slope on what the speed says of it, median over the logs."""
  slopes: dict[str, list[float]] = {}
  for recording in recordings:
    for comparison in compare(recording, {}):
      slope, alike = comparison.slope()
      if "speed" in comparison.takes and alike > UNIT_CORRELATION:
        slopes.setdefault(comparison.channel, []).append(slope)
  return {channel: float(np.median(each)) for channel, each in slopes.items()}
