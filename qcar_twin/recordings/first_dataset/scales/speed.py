"""In which unit a speed is whose name says none and that no place shows: by accelerometers, else a person is asked.

A speed in another unit makes accelerations along, d(speed)/dt, and across, speed times yaw rate, too large by one
factor. A clock that is off shows along alone, a gyro in degrees across alone. Accelerometers may be in g as well.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.recordings.checks.units import EXACT, UNIT_CORRELATION, compare
from qcar_twin.recordings.first_dataset.columns import Columns, Guess
from qcar_twin.recordings.first_dataset.names import readings
from qcar_twin.recordings.first_dataset.refine import recordings_of
from qcar_twin.recordings.first_dataset.scales.travel import LEAST_LOCK
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.recordings.unit_names import BRACKET, UNITS, unit_of
from qcar_twin.vehicle.vehicle import GRAVITY, Vehicle

_UNITS = {name: UNITS[name][1] for name in ("m/s", "km/h", "mph", "knots", "cm/s", "mm/s")}
_ALONG_AND_ACROSS = ("accel_x", "accel_y")
_NEAR = 1.5  # of an accelerometer, which feels tilt and slip besides
_ONE_OF_TWO = 1.25  # factor between two units, within which accelerometers don't tell them apart
_LONGER = 1.5  # of the wheelbase that a log turns like, from which another unit of its speed would explain it
_PLACES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
FOLLOWED = 1.25  # factor between a commanded speed and the one that the place shows, within which it was reached
_A_WHILE, _HELD = 0.5, 0.05  # s under one command, and share of it by which that may vary
_LEAST = 20  # samples that tell
_ONE_SIZE = 2.0  # factor between a commanded speed and the one that was reached, within which they have one unit
_MOST = 99.0  # per cent of the samples that stay below what is said of the driving


def settle_speed_unit(columns: Columns, guesses: Mapping[str, Guess]) -> list[str]:
  """Read a speed in the usual unit by which the accelerometers along and across both show its motion; returns a
  question where two units are so near to each other that they may be either."""
  guess = guesses.get("speed")
  if guess is None or unit_of(guess.column) is not None:
    return []
  if abs(guess.scale) != 1.0:
    _settle_as_it_is(columns, guesses, guess)
  if "pose_x" in guesses:
    return []
  recordings = recordings_of(columns, {name: g for name, g in guesses.items() if name != "pose_yaw"})
  felt = [guesses[name] for name in _ALONG_AND_ACROSS if name in guesses]
  in_g = not any(g.named or g.scale != 1.0 or unit_of(g.column) for g in felt)
  tried = [(unit, g) for g in ((1.0, GRAVITY) if in_g else (1.0,)) for unit in _UNITS]
  off = {one: _off(recordings, _UNITS[one[0]] / one[1]) for one in tried}
  best, g = min(off, key=lambda one: off[one])
  now, left = off["m/s", 1.0], off[best, g]
  if best == "m/s" or now < math.log(_NEAR) or not left < math.log(_NEAR):
    return []
  factor = _UNITS[best]
  guess.scale, guess.offset, guess.named = factor * guess.scale, factor * guess.offset, True
  guess.why.append(f"both accelerometers show it in {best}: in m/s they and it differ {math.exp(now):.2g}-fold")
  for one in felt if g != 1.0 else ():
    one.scale, one.offset, one.named = g * one.scale, g * one.offset, True
    one.why.append(f"in g, as the speed changes in {best}")
  near = [unit for unit, other in _UNITS.items() if unit != best and max(other / factor, factor / other) < _ONE_OF_TWO]
  return [
    f"'{guess.column}' names no unit, and by the accelerometers it is in {best}, or in {unit}: for {unit} set scale = "
    f"{guess.scale / factor * _UNITS[unit]:.6g} on speed"
    for unit in near
  ]


def _settle_as_it_is(columns: Columns, guesses: Mapping[str, Guess], guess: Guess) -> None:
  """Take a speed that its size put into another unit as it is, in m/s, where the place, or both accelerometers, show
  the same motion so: a car of full size is faster than a small one."""
  raw = Guess("speed", guess.column, math.copysign(1.0, guess.scale), hold=guess.hold)
  recordings = recordings_of(columns, {**{n: g for n, g in guesses.items() if n != "pose_yaw"}, "speed": raw})
  if "pose_x" in guesses:
    told = [c.slope() for r in recordings for c in compare(r, {}) if {"speed", "pose_x"} <= set(c.takes)]
    same = [1.0 / EXACT < slope < EXACT for slope, alike in told if alike > UNIT_CORRELATION]
  else:
    same = [_off(recordings, 1.0) < math.log(_NEAR)]
  if not same or not all(same):
    return
  guess.scale, guess.named = raw.scale, True
  guess.why = [why for why in guess.why if "too much for" not in why]
  by = "the place" if "pose_x" in guesses else "both accelerometers"
  guess.why.append(f"in m/s, as {by} shows, though it reaches {columns.top(guess.column):.3g}")


def settle_letter(columns: Columns, guesses: dict[str, Guess]) -> None:
  """A command called `cmd_v` is a speed where the place moves as fast as it says, in m, mm or cm, which no voltage does
  by chance; the place is then in that unit."""
  voltage = guesses.get("motor_voltage")
  if voltage is None or {"speed", "motor_speed", "speed_command"} & guesses.keys() or "pose_x" not in guesses:
    return
  if BRACKET.search(voltage.column) or all(one.channel != "speed_command" for one in readings(voltage.column)):
    return
  trial = {name: g for name, g in guesses.items() if name in ("time", "pose_x", "pose_y")}
  ratio = reached(recordings_of(columns, {**trial, "motor_voltage": voltage}), "motor_voltage")
  unit = next((name for name, f in _PLACES.items() if 1.0 / FOLLOWED < f * ratio < FOLLOWED), None)
  if unit is None:
    return
  del guesses["motor_voltage"]
  why = f"its name says v, and by the place in {unit} the car goes {_PLACES[unit] * ratio:.2g} times as fast"
  guesses["speed_command"] = Guess("speed_command", voltage.column, hold=voltage.hold, why=[why])
  for name in ("pose_x", "pose_y") if unit != "m" else ():
    guesses[name].scale *= _PLACES[unit]
    guesses[name].why.append(f"in {unit}, by '{voltage.column}' in m/s")


def reached(recordings: Sequence[Recording], channel: str, measured: bool = False) -> float:
  """Speed over a command, median where that was more than half of its largest for a while; NaN without any. `measured`:
  a speed that comes of the place does not count."""
  ratios = [np.empty(0)]
  for recording in (r for r in recordings if "speed" in r and channel in r):
    if measured and "speed" in recording.derived:
      continue
    speed = recording["speed"]
    now, before = (np.abs(recording[channel].at(speed.time - ago)) for ago in (0.0, _A_WHILE))
    there = (np.abs(now - before) < _HELD * now) & (now > 0.5 * np.max(np.abs(recording[channel].value)))
    ratios.append(np.abs(speed.value[there]) / now[there])
  ratio = np.concatenate(ratios)
  return float(np.median(ratio)) if ratio.size >= _LEAST else math.nan


def _off(recordings: Sequence[Recording], factor: float) -> float:
  """How far the accelerations along and across are from those of the speed times a factor: the larger of the two
  logarithms' sizes; inf where either shows nothing."""
  slopes: dict[str, list[float]] = {name: [] for name in _ALONG_AND_ACROSS}
  for recording in recordings:
    if "speed" not in recording or "speed" in recording.derived:
      continue
    speed = recording["speed"]
    scaled = recording.replace(streams={**recording.streams, "speed": Stream(speed.time, factor * speed.value)})
    for comparison in compare(scaled, {}):
      slope, alike = comparison.slope()
      if comparison.channel in slopes and alike > UNIT_CORRELATION:
        slopes[comparison.channel].append(math.log(slope))
  return max(abs(float(np.median(each))) if each else math.inf for each in slopes.values())


def asked_of_speed(
  guesses: Mapping[str, Guess], recordings: Sequence[Recording], vehicle: Vehicle, turns_like: float, said: float | None
) -> list[str]:
  """A question where a speed's name says no unit, no sensor shows its size, and the car turns like one that is longer
  than usual, or hardly steered at the wheelbase that was `said`: so it is, or its speed is in another unit."""
  guess, steering = guesses.get("speed"), guesses.get("steering_command")
  if guess is None or steering is None or guess.named or guess.scale != 1.0 or unit_of(guess.column) is not None:
    return []
  if {"pose_x", *_ALONG_AND_ACROSS} & guesses.keys():
    return []
  angles = [np.abs(r["steering_command"].value).max() for r in recordings if "steering_command" in r]
  slight = said is not None and not steering.named and 0.0 < max(angles, default=0.0) < LEAST_LOCK
  if not slight and (said is not None or turns_like < _LONGER * vehicle.wheelbase):
    return []
  speeds = [np.abs(r["speed"].value) for r in recordings if "speed" in r]
  across = [
    np.abs(r["speed"].value * r["yaw_rate"].interpolate(r["speed"].time)) for r in recordings if "yaw_rate" in r
  ]
  if not speeds or not across:
    return []
  top, side = (float(np.nanpercentile(np.concatenate(each), _MOST)) for each in (speeds, across))
  f = _UNITS["km/h"]
  by = lambda f: (
    f"{f * top:.2g} m/s, {f * side / GRAVITY:.1g} g across"
    + (
      f" and an angle of {max(angles) / f:.2g} rad"
      if slight
      else f" and turned like a wheelbase of {f * turns_like:.2g} m"
    )
  )
  return [
    f"'{guess.column}' names no unit, and nothing in the log shows its size: in m/s the car reached {by(1.0)}, in km/h "
    f"{by(f)}; for km/h call the column '{guess.column} [km/h]' and run new again into another folder"
  ]


def settle_commanded_unit(columns: Columns, guesses: Mapping[str, Guess]) -> None:
  """A commanded speed whose name says no unit is in that of the measured speed, where their columns are of one size."""
  speed, command = guesses.get("speed"), guesses.get("speed_command")
  if speed is None or command is None or abs(speed.scale) == 1.0 or command.scale != 1.0:
    return
  if unit_of(command.column) is not None:
    return
  size = columns.top(command.column) / max(columns.top(speed.column), 1e-9)
  if 1.0 / _ONE_SIZE < size < _ONE_SIZE:
    command.scale, command.offset = abs(speed.scale), abs(speed.scale) * command.offset
    command.why.append(f"of the size of '{speed.column}', so in its unit")
