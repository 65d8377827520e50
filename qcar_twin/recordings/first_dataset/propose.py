"""Logs in, the text of a first dataset.toml out, every guess marked as one with its reason."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from qcar_twin.recordings.channels import CHANNELS, DRIVE_COMMANDS
from qcar_twin.recordings.checks.car import SIZES, check_car
from qcar_twin.recordings.first_dataset.axes import pointing_down, settle_sides, turning_right
from qcar_twin.recordings.first_dataset.by_unit import guess_by_unit, like_drive, like_steering
from qcar_twin.recordings.first_dataset.car import MARK, Car, as_text, as_value, of_size
from qcar_twin.recordings.first_dataset.columns import Columns, Guess, guess_columns
from qcar_twin.recordings.first_dataset.mount import lies, settle_gravity, settle_imu, settle_left
from qcar_twin.recordings.first_dataset.parts.called import told_apart
from qcar_twin.recordings.first_dataset.parts.torn import refuse_parts
from qcar_twin.recordings.first_dataset.plane import settle_plane, without_half_a_place
from qcar_twin.recordings.first_dataset.refine import recordings_of, settle, settle_gear, usual_gearing
from qcar_twin.recordings.first_dataset.roles import Part, as_driven, share_out
from qcar_twin.recordings.first_dataset.scales.brake import settle_brake
from qcar_twin.recordings.first_dataset.scales.clock import BY_ROW, by_rows, rate_of
from qcar_twin.recordings.first_dataset.scales.engine import leave_engine
from qcar_twin.recordings.first_dataset.scales.gyro import settle_gyro_counts
from qcar_twin.recordings.first_dataset.scales.promised import settle_promised
from qcar_twin.recordings.first_dataset.scales.raw import asked_of_raw
from qcar_twin.recordings.first_dataset.scales.speed import (
  asked_of_speed,
  settle_commanded_unit,
  settle_letter,
  settle_speed_unit,
)
from qcar_twin.recordings.first_dataset.scales.wheels import settle_wheels
from qcar_twin.recordings.first_dataset.several import runner_up, settle_several
from qcar_twin.recordings.first_dataset.speeds import settle_speeds, settle_turns, settle_way
from qcar_twin.recordings.first_dataset.unused import said_of
from qcar_twin.recordings.formats import Table
from qcar_twin.recordings.formats.axles import of_wheels
from qcar_twin.recordings.recording import Recording, RecordingError
from qcar_twin.recordings.topic_maps import TopicMap, topic_maps
from qcar_twin.recordings.unit_names import is_electrical
from qcar_twin.vehicle.drive import DRIVES
from qcar_twin.vehicle.vehicle import Vehicle

# what a person may say of the car: wheelbase and wheel radius in m, mass in kg, turns of a wheel per turn of the motor
SAID = ("wheelbase", "mass", "wheel_radius", "gear_ratio")
_NEEDED = {"motor_speed": ("motor_speed", "speed"), "motor_voltage": DRIVE_COMMANDS}
_LISTED = 60  # columns at most


@dataclass(frozen=True)
class Proposal:
  """A dataset.toml, and what no column seems to be.

  Attributes:
    text: of the file.
    channels: of its lines those of [channels], or of what a ready-made map says.
    missing: what the loader needs and no column seems to be.
    questions: what several columns may equally be; the loader refuses the file until a person has chosen.
  """

  text: str
  channels: tuple[str, ...]
  missing: tuple[str, ...]
  questions: tuple[str, ...] = ()

  @property
  def guesses(self) -> tuple[str, ...]:
    """A line each, as they stand in the file."""
    return tuple(line for line in self.text.splitlines() if MARK in line and not line.startswith("#"))


def propose(name: str, tables: Sequence[Table], rate: float | None = None, **said: float) -> Proposal:
  """A first dataset.toml for logs; `Table.label` is the file's name in the folder. Where every clock is a date's they
  are listed in the order they were driven, else as they are given.

  Args:
    rate: rows a second of logs without a clock, where a person says it.
    said: of SAID, in m, kg and turns of a wheel per turn of the motor, where a person says them; the log's motion
      and the wheelbase tell else.

  Raises:
    RecordingError: there are no logs, or no car can have these figures.
  """
  if not tables:
    raise RecordingError("no log was given; name at least one file")
  _check_said(said)
  topics, columns = _fitting_map(tables), Columns(tables := by_rows(tables, rate), said.get("gear_ratio"))
  known: Mapping[str, float | str] = topics.vehicle if topics else {}
  guesses = _mapped(topics, tables) if topics is not None else _named(columns)
  kind, why = _drive(guesses)
  kind = str(known.get("drive", kind))
  vehicle = Vehicle.from_dataset({"name": "car", **known, "drive": kind})
  wheelbase = said.get("wheelbase")
  if wheelbase is not None:
    vehicle = of_size(vehicle, wheelbase)
  vehicle = dataclasses.replace(vehicle, **{key: said[key] for key in ("wheel_radius", "gear_ratio") if key in said})
  turns_like, asked, gearing, turned, unsure = vehicle.wheelbase, (), None, False, []
  moved = settle_promised(columns, guesses, {key: getattr(vehicle, key) for key in SIZES}) if topics is not None else {}
  if topics is None:
    settle_gear(columns, guesses)
    asked = settle_several(columns, guesses, {key: getattr(vehicle, key) for key in SIZES})
    settle_plane(columns, guesses)
    guesses = without_half_a_place(guesses)
    settle_way(columns, guesses)
    settle_brake(columns, guesses, vehicle.wheelbase)
    settle_gravity(columns, guesses)
    unsure += settle_gyro_counts(columns, guesses, {key: getattr(vehicle, key) for key in SIZES})
    turned = _settle_axes(columns, guesses)
    unsure += settle_wheels(columns, guesses, vehicle) or settle_speed_unit(columns, guesses)
    gearing = None if "gear_ratio" in said else _gearing(columns, guesses, vehicle)
    vehicle = dataclasses.replace(vehicle, gear_ratio=gearing or vehicle.gear_ratio)
    turns_like = settle(columns, guesses, vehicle, {key: getattr(vehicle, key) for key in SIZES}, wheelbase)
    settle_left(columns, guesses)
    settle_commanded_unit(columns, guesses)
    unsure += asked_of_raw(columns, guesses)
    unsure += asked_of_speed(guesses, recordings_of(columns, guesses), vehicle, turns_like, wheelbase)
  car = Car(vehicle, known, kind, why, said, turns_like, gearing)
  if topics is None:
    settle_turns(guesses, car.sizes, recordings_of(columns, guesses))
  recordings = as_driven(recordings_of(columns, guesses))
  missing = _missing(guesses, tables)
  parts = [*share_out(recordings, DRIVES[kind].steps), *_left_over(tables, recordings)] if recordings else []
  parts = parts if recordings and (not missing or len(recordings) == len(tables)) else _all_fitted(tables)
  questions = (*(question.text for question in asked), *unsure)
  questions += _asked_of(columns, guesses, recordings, turned) if topics is None else ()
  questions += _electrical(guesses) if topics is None and gearing is None else ()  # else the gear ratio makes up for it
  lines = [*_head(name, topics, questions), *_names(tables), *car.lines(recordings)]
  channels = _channels(columns, guesses, missing) if topics is None else _by_map(columns, guesses, moved)
  lines += ["", *channels]
  lines += [line for part in told_apart(parts) for line in _recording(part)]
  return Proposal("\n".join(lines) + "\n", tuple(channels[1:]), missing, questions)


def _settle_axes(columns: Columns, guesses: dict[str, Guess]) -> bool:
  """Settle how the IMU lies and which way a log counts, without an engine; returns whether the IMU lies upside down."""
  turned = settle_imu(columns, guesses)
  leave_engine(guesses, recordings_of(columns, guesses))
  settle_sides(columns, guesses)
  return turned


def _gearing(columns: Columns, guesses: Mapping[str, Guess], vehicle: Vehicle) -> float | None:
  own = "motor_speed" in guesses and not of_wheels(guesses["motor_speed"].column)
  return usual_gearing(recordings_of(columns, guesses), vehicle, place=own)


def _check_said(said: Mapping[str, float]) -> None:
  if unknown := sorted(said.keys() - set(SAID)):
    raise RecordingError(f"{unknown[0]} is not asked for; said may be {', '.join(SAID)}")
  if wrong := [key for key, value in said.items() if not 0.0 < value < math.inf]:
    raise RecordingError(f"{wrong[0]} must be a positive number, not {said[wrong[0]]:g}")
  ends = dict.fromkeys(("cg_to_front", "cg_to_rear"), 0.5 * said["wheelbase"]) if "wheelbase" in said else {}
  check_car(ends | {key: said[key] for key in said if key != "wheelbase"}, "what was said of the car:")


def _missing(guesses: Mapping[str, Guess], tables: Sequence[Table]) -> tuple[str, ...]:
  """What the loader needs and no column seems to be."""
  stood_for = {"motor_speed"} if {"pose_x", "pose_y"} <= guesses.keys() else set()
  moves = stood_for or guesses.keys() & {"motor_speed", "speed"}
  if moves and "steering_command" in guesses:  # somebody drove by hand, and the speed stands for the command
    stood_for |= {"motor_voltage"}
  missing = tuple(
    " or ".join(names)
    for channel, names in _NEEDED.items()
    if not guesses.keys() & set(names) and channel not in stood_for
  )
  if "time" not in guesses and not all("time" in table for table in tables):
    missing = ("time", *missing)
  return missing


def _asked_of(
  columns: Columns, guesses: dict[str, Guess], recordings: Sequence[Recording], turned: bool
) -> tuple[str, ...]:
  """What only a person can tell of the columns that were guessed; an IMU that was `turned` has told how it lies."""
  told = lies(columns, guesses)
  right = turning_right(columns, guesses, told)
  down = None if turned or told or right else pointing_down(columns, guesses, recordings)
  return (*right, *([down] if down is not None else []))


def _electrical(guesses: Mapping[str, Guess]) -> tuple[str, ...]:
  """A question where a motor's speed is of its field: an electronic commutator's revolutions per minute."""
  guess = guesses.get("motor_speed")
  if guess is None or not is_electrical(guess.column):
    return ()
  return (
    f"'{guess.column}' counts electrical revolutions, the motor's times its pole pairs, and motor_speed is read as "
    "of 2: has your motor 2 (4 poles)? divide the scale by what else it has, over 2",
  )


def _fitting_map(tables: Sequence[Table]) -> TopicMap | None:
  """The ready-made map that finds most channels, a drive command and a speed among them, in every log."""
  fits = []
  if not all(
    "time" in table for table in tables
  ):  # of bags it is; a topic's columns in a text have a clock of their own
    return None
  for topics in topic_maps().values():
    try:
      channels = [set(topics.mapping(table.columns, table.label)) for table in tables]
    except RecordingError:
      continue
    if all(each & set(DRIVE_COMMANDS) and each & {"speed", "motor_speed"} for each in channels):
      fits.append((min(map(len, channels)), topics))
  return max(fits, key=lambda fit: fit[0])[1] if fits else None


def _mapped(topics: TopicMap, tables: Sequence[Table]) -> dict[str, Guess]:
  guesses: dict[str, Guess] = {"time": Guess("time", "time", why=["seconds since the bag began"])}
  for table in tables:
    for channel, how in topics.mapping(table.columns, table.label).items():
      guesses.setdefault(
        channel, Guess(channel, how.column, how.scale, how.offset, how.wrap, why=[f"map {topics.name}"])
      )
  return guesses


def _named(columns: Columns) -> dict[str, Guess]:
  """By names and units, speeds by which goes first; RecordingError where commands and motion lie in files of their
  own."""
  guesses = guess_columns(columns)
  settle_speeds(columns, guesses)
  guess_by_unit(columns, guesses)
  settle_letter(columns, guesses)
  if {"speed", "motor_speed"} <= guesses.keys() and is_electrical(guesses["motor_speed"].column):
    del guesses["motor_speed"]  # the speed needs no pole pairs
  guesses = {channel: guesses[channel] for channel in CHANNELS if channel in guesses}
  refuse_parts(columns, guesses)
  return guesses


def _drive(guesses: Mapping[str, Guess]) -> tuple[str, str]:
  """What drives the car, and why: the kind whose command was logged, first of DRIVE_COMMANDS."""
  by_hand = "speed_command" if "steering_command" in guesses else DRIVE_COMMANDS[0]
  logged = next((name for name in DRIVE_COMMANDS if name in guesses), None)
  kind = next(kind for kind, drive in DRIVES.items() if drive.channel == (logged or by_hand))
  if logged is None:
    return kind, "no column says it is the drive's command; correct it by the one you map"
  return kind, f"the log's drive command is {logged}"


def _left_over(tables: Sequence[Table], recordings: Sequence[Recording]) -> list[Part]:
  """What the guesses cannot read: those who read the file say why."""
  read = {recording.file for recording in recordings}
  why = "left over as the roles were shared out: it cannot be read as the others, or its car stood"
  return [Part(table.label, "identify", why=why) for table in tables if table.label not in read]


def _all_fitted(tables: Sequence[Table]) -> list[Part]:
  return [
    Part(table.label, "identify", why="the columns have to be known before driving can be shared out")
    for table in tables
  ]


def _head(name: str, topics: TopicMap | None, questions: Sequence[str]) -> list[str]:
  lines = [
    "# A first draft: a line with `guess:` is one, with its reason. Correct it, or delete the mark once it is true.",
    f"name = {as_text(name)}",
  ]
  if questions:
    lines.append(
      "# to be answered: correct its line in [channels], or leave it, and delete the question; else nothing is read"
    )
    lines.append(f"undecided = [{', '.join(map(as_text, questions))}]")
  if topics is not None:
    lines.append(f"map = {as_text(topics.name)}  # {MARK} the topics are those of {topics.about}")
  return lines


def _entry(columns: Columns, guess: Guess) -> str:
  """A channel's line in [channels]."""
  entry: dict[str, Any] = {"column": guess.column}
  if guess.column == BY_ROW:
    return f"{guess.channel} = {{ rate = {as_value(rate_of(columns.tables[0]))} }}  # as said: the logs have no clock"
  entry |= {"scale": guess.scale} if guess.scale != 1.0 else {}
  entry |= {"offset": guess.offset} if guess.offset != 0.0 else {}
  entry |= {"wrap": True} if guess.wrap else {}
  entry |= {"hold": True} if guess.hold else {}
  entry |= {key: name for key in ("gate", "signed_by", "minus") if (name := getattr(guess, key))}
  entry |= {key: True for key in ("steps", "sort") if getattr(guess, key)}
  inside = ", ".join(f"{key} = {as_value(value)}" for key, value in entry.items())
  why = [*guess.why, runner_up(columns, guess)]
  return f"{guess.channel} = {{ {inside} }}  # {MARK} {_plain('; '.join(filter(None, why)))}"


def _channels(columns: Columns, guesses: dict[str, Guess], missing: Sequence[str]) -> list[str]:
  lines = ["[channels]"]
  lines += [_entry(columns, guess) for guess in guesses.values()]
  if "time" in missing:
    lines.append(
      "# time = { rate = … }  # needed: the log's rate in Hz, which no column tells, where a row is a step: say --rate"
    )
  lines += [f'# {what} = {{ column = "…" }}  # needed, and no column says it is this; fill it in' for what in missing]
  taken = {name for guess in guesses.values() for name in (guess.column, guess.gate, guess.minus)}
  over = [
    name for name in dict.fromkeys(name for table in columns.tables for name in table.columns) if name not in taken
  ]
  if over:
    lines.append(f"# columns that are not used: {_plain(', '.join(over[:_LISTED]))}")
  lines += [f"# {_plain(said)}" for name in over if (said := said_of(columns, name))]
  lines += [f"# {_plain(said)}" for said in (like_steering(columns, guesses), like_drive(columns, guesses)) if said]
  for name in over[:_LISTED] if missing else ():
    if name in columns.names:
      values = columns.values(name)
      lines.append(f"# {_plain(name)}: {values.min():.4g} to {values.max():.4g}")
  return lines


def _names(tables: Sequence[Table]) -> list[str]:
  """The key that names the columns of files without a header, as they are called until a person has named them."""
  called = {tuple(table.columns) for table in tables if table.headless}
  if len(called) != 1:
    return []
  names = ", ".join(map(as_text, *called))
  return [f"columns = [{names}]  # the files have no header: a name for each, here and in [channels]"]


def _by_map(columns: Columns, guesses: Mapping[str, Guess], moved: Mapping[str, Guess]) -> list[str]:
  """What the map says, as a comment: the map itself says it to the loader. What `moved` from it as [channels]."""
  known = [guess for guess in guesses.values() if guess.channel in CHANNELS and guess.channel not in moved]
  lines = ["# what the map finds in these logs:", *(f"# {guess.channel}: {_plain(guess.column)}" for guess in known)]
  return lines + (["[channels]  # goes before the map", *(_entry(columns, g) for g in moved.values())] if moved else [])


def _recording(part: Part) -> list[str]:
  lines = ["", "[[recording]]", f"file = {as_text(part.file)}", f"role = {as_text(part.role)}  # {MARK} {part.why}"]
  if part.name:
    lines.insert(2, f"name = {as_text(part.name)}")
  if part.begin is not None:
    lines.append(f"from = {round(part.begin, 3)!r}  # {MARK} s on the file's clock")
  if part.end is not None:
    lines.append(f"to = {round(part.end, 3)!r}  # {MARK} s on the file's clock")
  if part.manoeuvre:
    lines.append(f"manoeuvre = {as_text(part.manoeuvre)}  # {MARK} {part.why_manoeuvre}")
  return lines


def _plain(value: str) -> str:
  """As a comment may hold it: on one line, no control characters."""
  return "".join(mark if mark.isprintable() else " " for mark in value)
