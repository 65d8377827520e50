"""Which of a log's speeds is what: commanded or measured, along the car or along an axis of the map, counted forwards
or, as of a motor that was wired the other way, backwards."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.recordings.channels import CHANNELS, DRIVE_COMMANDS
from qcar_twin.recordings.checks.acted import against, was_commanded
from qcar_twin.recordings.first_dataset.columns import Columns, Guess, hold, scale, stepped
from qcar_twin.recordings.first_dataset.heading import unwrap_heading
from qcar_twin.recordings.first_dataset.mount import ALIKE, speeding
from qcar_twin.recordings.first_dataset.names import readings
from qcar_twin.recordings.first_dataset.parts.motion import fit, motion_of
from qcar_twin.recordings.first_dataset.refine import recordings_of
from qcar_twin.recordings.first_dataset.scales.series import correlation
from qcar_twin.recordings.first_dataset.scales.speed import reached
from qcar_twin.recordings.first_dataset.scales.turning import Turning
from qcar_twin.recordings.recording import Recording
from qcar_twin.recordings.unit_names import BRACKET, is_odrive, unit_of, words_of

_ALIKE = 0.8  # correlation of two sensors of one motion, as the check has it
_APART = 0.05  # of a correlation, from which one of two readings is the better
_SLOPE = 0.1  # s, over which a place's slope is taken
_AXES = {"x", "y", "vx", "vy", "north", "east", "n", "e"}  # of a velocity in two columns
_WHEEL = {"wheel", "wheels"}
_PLACE = {"pose_x", "pose_y"}
_LEAST = 10  # samples that a correlation is worth
_MEAN, _LEAST_MEANS = 0.25, 20  # s, over which way and speed are compared, and how many of these tell anything
# besides the command: an IMU that lies reversed and a steering to the right are usual by themselves, and a command that
# counts back next to both is rarer than a speed that does
_WITNESSES = 2
_NEARLY = 0.8  # of a command's sum of magnitudes that is positive, of a car that is driven forwards


def settle_speeds(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Tell commanded speeds from measured ones by which goes first, and the car's own from the map's by its place, where
  names and units do not."""
  _stepped_is_commanded(columns, guesses)
  _alone_and_commanded(columns, guesses)
  _two_of_one_unit(columns, guesses)
  _one_letter(columns, guesses)
  _along_the_map(columns, guesses)
  _outer_loop(guesses)


def _stepped_is_commanded(columns: Columns, guesses: dict[str, Guess]) -> None:
  """A speed that stays and steps, and that another speed follows, is what was commanded, whatever it is called."""
  chosen = guesses.get("speed")
  if chosen is None:
    return
  taken = {guess.column for guess in guesses.values()} - {chosen.column}
  free = [name for name in _speeds(columns) if name not in taken]
  steps = [name for name in free if stepped(columns, name, "speed")]
  smooth = [chosen.column] if chosen.column not in steps else [name for name in free if name not in steps]
  pairs = [(name, command) for name in smooth for command in steps if chosen.column in (name, command)]
  alike = {pair: follows(columns, guesses, *pair) for pair in pairs}
  best = max(pairs, key=lambda pair: alike[pair], default=None)
  if best is None or alike[best] < _ALIKE:
    return
  measured, command = best
  if measured != chosen.column:
    _put(columns, guesses, "speed", measured, f"'{command}' stays and steps, and this follows it ({alike[best]:.2f})")
  if not guesses.keys() & set(DRIVE_COMMANDS):
    _put(columns, guesses, "speed_command", command, f"it stays and steps, and '{measured}' follows it")


def _alone_and_commanded(columns: Columns, guesses: dict[str, Guess]) -> None:
  """The only speed of a log is the commanded one where it leaps as no car does; the place then gives the car's own."""
  if "speed" not in guesses or guesses.keys() & {"motor_speed", *DRIVE_COMMANDS} or not guesses.keys() >= _PLACE:
    return
  without_yaw = {name: guess for name, guess in guesses.items() if name != "pose_yaw"}  # its unit is not settled yet
  if was_commanded(recordings_of(columns, without_yaw), "speed"):
    why = "it leaps from level to level as no car does, and the place gives the measured one"
    _put(columns, guesses, "speed_command", guesses.pop("speed").column, why)


def _two_of_one_unit(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Of two columns that name a unit of speed in brackets and nothing known, the one that goes first is commanded."""
  if guesses.keys() & {"speed", "motor_speed", *DRIVE_COMMANDS}:
    return
  names = [name for name in columns.names if not readings(name) and _in_brackets(name) and not columns.constant(name)]
  if len(names) != 2:
    return
  alike = [follows(columns, guesses, *pair) for pair in (names, names[::-1])]
  if max(alike) < _ALIKE:
    return
  measured, commanded = names if alike[0] > alike[1] else names[::-1]
  _put(columns, guesses, "speed", measured, f"of two columns in such a unit it follows the other ({max(alike):.2f})")
  _put(columns, guesses, "speed_command", commanded, f"of two columns in such a unit '{measured}' follows it")


def _one_letter(columns: Columns, guesses: dict[str, Guess]) -> None:
  """A letter means one quantity in a log: beside a speed that is called v, `v_cmd` is no voltage."""
  voltage, speed = guesses.get("motor_voltage"), guesses.get("speed")
  if voltage is None or speed is None or "speed_command" in guesses or BRACKET.search(voltage.column):
    return
  if all(reading.channel != "speed_command" for reading in readings(voltage.column)):
    return
  if "v" in words_of(voltage.column) and "v" in words_of(speed.column):
    del guesses["motor_voltage"]
    why = f"its name says v {' '.join(w for w in words_of(voltage.column) if w != 'v')}; '{speed.column}' is a speed"
    _put(columns, guesses, "speed_command", voltage.column, why)


def _outer_loop(guesses: dict[str, Guess]) -> None:
  """Of a commanded speed and the current that its controller asks of the motor, the speed is what was commanded."""
  current, speed = guesses.get("motor_current"), guesses.get("speed_command")
  if current and speed and is_odrive(current.column) and is_odrive(speed.column):
    del guesses["motor_current"]
    speed.why.append(f"'{current.column}' is what its controller makes of it")


def settle_turns(
  guesses: Mapping[str, Guess], sizes: Mapping[str, float], recordings: Sequence[Recording] = ()
) -> None:
  """A commanded speed that is the motor's or a wheel's, in rad/s or turns, as the car's, m/s: by the speed that was
  measured, as fast as the car went under it; else by gear and wheel of [vehicle], so that it goes with the motor's."""
  guess = guesses.get("speed_command")
  if guess is None or (unit := unit_of(guess.column)) is None or unit[1] != CHANNELS["motor_speed"].unit:
    return
  if math.isfinite(metres := reached(recordings, "speed_command", measured=True)):
    guess.scale, guess.offset = guess.scale * metres, guess.offset * metres
    guess.why.append(f"as fast as the car went under it: {metres:.4g} m to a rad")
    return
  of_wheel = bool(_WHEEL & set(words_of(guess.column)))
  by = ("wheel_radius",) if of_wheel else ("gear_ratio", "wheel_radius")
  travel = math.prod(sizes[key] for key in by)
  guess.scale, guess.offset = guess.scale * travel, guess.offset * travel
  whose, said = "a wheel" if of_wheel else "the motor", " and ".join(f"{key} {sizes[key]:.4g}" for key in by)
  guess.why.append(f"of {whose}, so times {said} of [vehicle]; correct it with them, no column tells them")


def follows(columns: Columns, guesses: dict[str, Guess], measured: str, commanded: str) -> float:
  """How alike two speeds are, by correlation, where the first comes later; 0 where it does not, or nothing tells."""
  clock = guesses.get("time")
  tables = [table for table in columns.tables if measured in table and commanded in table]
  if clock is None or clock.steps or not tables:
    return 0.0
  longest = Columns([max(tables, key=lambda table: table.number(measured, measured).size)])
  later, first = (motion_of(longest, {"time": clock, "speed": Guess("speed", name)}) for name in (measured, commanded))
  answer = fit(later, first)
  return answer.alike if math.isfinite(answer.alike) and answer.lag > 0.0 else 0.0


def _along_the_map(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Drop a speed that is the place's slope along an axis of the map, as simulators and autopilots log it: another
  column is the speed, or none, and it comes of the place."""
  while (speed := guesses.get("speed")) is not None and (alike := _slope_of_place(columns, guesses, speed.column)):
    said = f"'{speed.column}' is its slope ({alike:.2f}), a speed along an axis of the map and not of the car"
    guesses["pose_x"].why.append(said)
    del guesses["speed"]
    taken = {guess.column for guess in guesses.values()}
    others = [name for name in _speeds(columns) if name not in taken and not set(_bare(name)) & _AXES]
    if others:
      _put(columns, guesses, "speed", others[0], "its name says a speed")


def _slope_of_place(columns: Columns, guesses: dict[str, Guess], name: str) -> float:
  """Correlation of a velocity's first part with the slope of the place, where that explains it and the way does not;
  else 0."""
  if not {"time", "pose_x", "pose_y"} <= guesses.keys() or guesses["time"].steps or not set(_bare(name)) & _AXES:
    return 0.0
  table = max(columns.holding(name), key=lambda t: t.number(name, "speed").size)
  sources = [guesses["time"].column, name, guesses["pose_x"].column, guesses["pose_y"].column]
  if not all(column in table for column in sources):
    return 0.0
  read = np.stack([table.number(column, "speed") for column in sources])
  time, value, x, y = read[:, np.isfinite(read).all(axis=0)]
  time = guesses["time"].scale * time
  if time.size < _LEAST or not (np.diff(time) > 0.0).all():
    return 0.0
  at = lambda values, shift: np.interp(time + shift, time, values)
  slopes = [(at(p, 0.5 * _SLOPE) - at(p, -0.5 * _SLOPE)) / _SLOPE for p in (x, y)]
  along_map = max(abs(correlation(value, slope, _LEAST)) for slope in slopes)
  along_car = abs(correlation(np.abs(value), np.hypot(*slopes), _LEAST))
  return along_map if along_map > max(_ALIKE, along_car + _APART) else 0.0


def _bare(name: str) -> tuple[str, ...]:
  return words_of(BRACKET.sub(" ", name))


def _speeds(columns: Columns) -> list[str]:
  """Columns whose names may mean a measured speed, and that change."""
  meant = lambda name: any(reading.channel == "speed" for reading in readings(name))
  return [name for name in columns.names if meant(name) and not columns.constant(name)]


def _in_brackets(name: str) -> bool:
  return bool(BRACKET.search(name)) and (unit := unit_of(name)) is not None and unit[1] == CHANNELS["speed"].unit


def _put(columns: Columns, guesses: dict[str, Guess], channel: str, column: str, why: str) -> None:
  guesses[channel] = Guess(channel, column, why=[why])
  scale(columns, guesses[channel])
  if "time" in guesses:
    hold(columns, {"time": guesses["time"], channel: guesses[channel]})


def settle_way(columns: Columns, guesses: dict[str, Guess]) -> None:
  """Where the car goes backwards under positive commands, count the speed the other way if two more of accelerometer,
  steering and path along the heading contradict it while none agrees, and the command if they agree with the speed."""
  drive = next((name for name in DRIVE_COMMANDS if name in guesses), None)
  speeds = [name for name in ("speed", "motor_speed") if name in guesses]
  if drive and not speeds:
    _settle_backward_heading(columns, guesses, drive)
  recordings = recordings_of(columns, guesses) if drive and speeds else []
  if not drive or not recordings or not against(recordings, drive):
    return
  told = {
    "the accelerometer": speeding(columns, guesses, guesses["accel_x"].column) if "accel_x" in guesses else 0.0,
    "the steering": _turning(recordings) if "steering_command" in guesses else 0.0,
    "the path along the heading": _along(recordings),
  }
  for turned, sign in ((speeds, -1.0), ([drive], 1.0)):
    witnesses = [name for name, alike in told.items() if sign * alike > ALIKE]
    if len(witnesses) < _WITNESSES or any(sign * alike < -ALIKE for alike in told.values()):
      continue
    for guess in (guesses[name] for name in turned):
      other = "the command" if turned == speeds else "the speed"
      guess.reverse(f"counted the other way: {other}, {' and '.join(witnesses)} say so")


def _settle_backward_heading(columns: Columns, guesses: dict[str, Guess], drive: str) -> None:
  """Turn a heading by half a turn where it alone says which way the car goes, and the car goes backwards along it under
  commands that are nearly all positive: a camera's axes point backwards, or a marker was put on so."""
  if not {"pose_x", "pose_y", "pose_yaw"} <= guesses.keys():
    return
  unwrap_heading(columns, guesses)
  command, heading = guesses[drive], guesses["pose_yaw"]
  values = command.scale * columns.values(command.column) + command.offset
  ahead = np.sum(values[values > 0.0]) > _NEARLY * np.sum(np.abs(values))
  if ahead and against(recordings_of(columns, guesses), drive):
    heading.offset += math.pi
    heading.why.append(f"it points backwards: along it the car goes back under a positive {drive}")


def _turning(recordings: Sequence[Recording]) -> float:
  return Turning.of(recordings).alike(_LEAST_MEANS)


def _along(recordings: Sequence[Recording]) -> float:
  """Correlation of the measured speed with the way along the heading."""
  parts = [np.empty((2, 0))]
  for recording in recordings:
    name = "speed" if "speed" in recording else "motor_speed"
    if not {"pose_x", "pose_y", "pose_yaw", name} <= set(recording.channels) or name in recording.derived:
      continue
    edges = np.arange(recording.start, recording.end, _MEAN)
    middle = 0.5 * (edges[1:] + edges[:-1])
    x, y = (np.diff(recording[one].interpolate(edges)) for one in ("pose_x", "pose_y"))
    yaw = recording["pose_yaw"].interpolate(middle)
    parts.append(np.stack([recording[name].interpolate(middle), x * np.cos(yaw) + y * np.sin(yaw)]))
  speed, way = np.concatenate(parts, axis=1)
  return correlation(speed, way, _LEAST_MEANS)
