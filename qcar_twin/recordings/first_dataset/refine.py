"""Guesses checked against each other: units by two sensors of one motion, a steering's scale by the turning it made."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.kinematics import rolling_radius
from qcar_twin.recordings.channels import DRIVE_COMMANDS
from qcar_twin.recordings.checks.neutral import drive_neutral, steering_neutral
from qcar_twin.recordings.checks.pushes import is_lifted
from qcar_twin.recordings.checks.units import UNIT_CORRELATION, Bins, Suspect, compare, of_most
from qcar_twin.recordings.completed import with_speed
from qcar_twin.recordings.first_dataset.columns import Columns, Guess
from qcar_twin.recordings.first_dataset.heading import goes_with, settle_gyro, settle_heading, unwrap_heading
from qcar_twin.recordings.first_dataset.scales.clock import in_time
from qcar_twin.recordings.first_dataset.scales.sensor import other_axes
from qcar_twin.recordings.first_dataset.scales.series import correlation
from qcar_twin.recordings.first_dataset.scales.sign import UNSIGNED, settle_sign
from qcar_twin.recordings.first_dataset.scales.travel import LEAST_LOCK, LOCK, is_share_of_lock
from qcar_twin.recordings.first_dataset.scales.turning import STEEPEST, Turning
from qcar_twin.recordings.mapping import resolve, streams_of
from qcar_twin.recordings.recording import Recording, RecordingError
from qcar_twin.recordings.row_clock import origin_of, stamps
from qcar_twin.recordings.unit_names import words_of
from qcar_twin.vehicle.vehicle import QCAR, Vehicle

Array = NDArray[np.float64]

_GEOGRAPHIC = ({"east", "easting", "utm"}, {"north", "northing", "utm"})  # a place whose left and right are known
_COMPASS = {"compass", "azimuth", "bearing", "gps", "gnss", "course", "cog"}  # clockwise from north by its name
_ROUNDS = 4  # of units, each of which may uncover the next
# units of speed so near to a clock's at twice the speed that only where a gyro confirms the clock they are meant
_NEAR_A_CLOCKS = tuple(
  (1.0 / scale, Suspect("speed", unit, scale)) for unit, scale in (("mph", 0.44704), ("knots", 1852.0 / 3600.0))
)
_SAME_UNIT = (
  2.0  # factor between two sensors of one motion, within which they have one unit: usual units differ by 2.24
)
_GEARS = {"gear", "gears", "direction", "dir"}
_GEARED, _ALIKE_ROWS = 0.95, 20  # correlation of two speeds, and rows, from which the one is a multiple of the other
_TIED = 0.7  # correlation from which turning says what a steering command means
_SAME_WHEELBASE = (0.9, 1.1)  # of the angle: within it the guessed wheelbase stays
_LEAST = 10  # bins that tell how a car turned
_NO_ANGLE = "no angle turns a car as much as this one turned at its speed: look at speed and yaw rate first"
_LONGEST = 6.0  # m, of a lorry's wheelbase
_ROAD_ANGLE = (0.6, 1.6)  # of the angle kinematics ask for: a command within it is the angle itself


def recordings_of(columns: Columns, guesses: Mapping[str, Guess]) -> list[Recording]:
  """The logs as the guesses read them; those that cannot be read so, or whose car stood with its wheels in the air, are
  left out."""
  mapping, recordings = {channel: guess.mapped for channel, guess in guesses.items()}, []
  for table in columns.tables:
    try:
      by = resolve(table, mapping)
      first = origin_of(stamps(table, by["time"]))
      read = Recording(table.label, streams_of(table, by)[0], table.label, origin=(first, 0.0, 0.0))
      recordings.append(with_speed(read)[0])
    except RecordingError:
      continue
  driven = [recording for recording in recordings if not is_lifted(recording, rolling_radius(QCAR))]
  return driven or recordings


def settle_units(columns: Columns, guesses: dict[str, Guess], vehicle: Mapping[str, float | str]) -> None:
  """Scale what disagrees with another channel by the factor of a usual unit, as the loader would ask for."""
  for _ in range(_ROUNDS):
    recordings = recordings_of(columns, guesses)
    wrong = [unit for recording in recordings if (unit := _convicted(recording, vehicle, guesses))]
    if not wrong:
      return
    channel, scale, why = wrong[0]
    sound = sum(_agrees(recording, vehicle, channel) for recording in recordings)
    if sum(unit[0] == channel for unit in wrong) < sound:
      return  # a few files in another unit than the rest: the loader names them
    others = [n for n in other_axes(guesses, channel) if not any(_agrees(r, vehicle, n) for r in recordings)]
    for name in ("pose_x", "pose_y") if channel == "pose_x" else (channel, *others):
      guesses[name].scale *= scale
      guesses[name].why.append(why if name not in others else f"{why}, and this is another axis of its sensor")


def _agrees(recording: Recording, vehicle: Mapping[str, float | str], channel: str) -> bool:
  """Whether a channel agrees with a witness, so that its unit is right in this log."""
  comparisons = [c for c in compare(recording, vehicle) if channel in c.takes and not c.convicted()]
  slopes = [slope for slope, correlation in (c.slope() for c in comparisons) if correlation > UNIT_CORRELATION]
  return any(1.0 / _SAME_UNIT < slope < _SAME_UNIT for slope in slopes)


def _convicted(
  recording: Recording, vehicle: Mapping[str, float | str], guesses: Mapping[str, Guess]
) -> tuple[str, float, str] | None:
  confirmed, comparisons = in_time(recording), compare(recording, vehicle)
  for comparison in comparisons:
    slope, correlation = comparison.slope()
    by_place = "speed" in guesses and {"speed", "pose_x"} <= set(comparison.takes)
    if confirmed and by_place and not guesses["speed"].named:
      comparison = dataclasses.replace(comparison, suspects=(*comparison.suspects, *_NEAR_A_CLOCKS))
    steering = guesses.get("steering_command")  # none where the car drove straight
    if "steering_command" in comparison.takes and (steering is None or not steering.named):
      continue  # what it is in comes from how the car turned, once speed and gyro are settled
    units = [unit for unit in comparison.convicted() if not unit.already] if correlation > UNIT_CORRELATION else []
    if [unit.channel for unit in units] == ["pose_yaw"] and goes_with([recording]):
      said = f"{comparison.channel} is {slope:.3g} times {comparison.witness}, which the path confirms"
      return "yaw_rate", 1.0 / units[0].scale, f"{said}: not in {guesses['yaw_rate'].column}'s unit"
    units = [unit for unit in units if unit.channel in guesses and not guesses[unit.channel].named]
    if len(units) > 1:
      units = of_most(units, [other for other in comparisons if other.channel != comparison.channel])
    if len(units) == 1:
      return (
        units[0].channel,
        units[0].scale,
        f"{comparison.channel} is {slope:.3g} times {comparison.witness}: {units[0].unit}",
      )
  return None


def settle_gear(columns: Columns, guesses: Mapping[str, Guess]) -> None:
  """Speeds without a sign get that of a gear of -1, 0 and 1, where one was logged.

  So does a drive command that goes with the speed better so.
  """
  taken = {guess.column for guess in guesses.values()}
  for name in columns.names:
    if name in taken or not set(words_of(name)) & _GEARS or len(columns.holding(name)) != len(columns.tables):
      continue
    gear = _rows(columns, name)
    seen = set(np.unique(gear[np.isfinite(gear)]))
    if not {-1.0, 1.0} <= seen <= {-1.0, 0.0, 1.0}:
      continue
    for guess in (guesses[channel] for channel in ("motor_speed", "speed") if channel in guesses):
      size = _rows(columns, guess.column)
      least = UNSIGNED * columns.top(guess.column)
      if np.nanmin(size) < -least or np.any(np.abs(size[gear == 0.0]) > least):
        continue  # it has a sign, or the car rolls in neutral
      guess.gate = name
      guess.why.append(f"it carries no sign, and '{name}' is -1 or 1")
      for drive in (guesses[channel] for channel in DRIVE_COMMANDS if channel in guesses):
        command, speed = _rows(columns, drive.column), size * gear
        if drive.gate is None and correlation(command * gear, speed) > correlation(command, speed):
          drive.gate = name
          drive.why.append(f"times '{name}' it goes with the speed")


def _rows(columns: Columns, name: str) -> Array:
  """A column row by row, one log after the other; NaN where it is blank, or a log has none."""
  return np.concatenate([t.number(name, name) if name in t else np.full(t.rows, np.nan) for t in columns.tables])


def settle_pose(columns: Columns, guesses: Mapping[str, Guess]) -> None:
  """Unwrap a heading, then what the path says of it."""
  unwrap_heading(columns, guesses)
  heading = guesses.get("pose_yaw")
  if heading is None:
    return
  place = [set(words_of(guesses[name].column)) for name in ("pose_x", "pose_y") if name in guesses]
  known = len(place) == len(_GEOGRAPHIC) and all(named & words for named, words in zip(place, _GEOGRAPHIC, strict=True))
  from_north = bool(set(words_of(heading.column)) & _COMPASS)
  settle_heading(heading, recordings_of(columns, guesses), known or from_north)
  if known:
    settle_gyro(guesses, recordings_of(columns, guesses))


def settle(
  columns: Columns,
  guesses: dict[str, Guess],
  vehicle: Vehicle,
  sizes: Mapping[str, float | str],
  said: float | None = None,
) -> float:
  """All guesses against each other, in one order until nothing moves: the heading's turns and all units, neutrals, then
  sign and geometry of the steering. Returns the wheelbase that the log turns like, m; the car's own where it says
  nothing else.

  Args:
    said: the wheelbase, m, where a person said it; then the angle alone moves.
  """
  wheelbase = vehicle.wheelbase
  for _ in range(_ROUNDS):
    before = {channel: guess.mapped for channel, guess in guesses.items()}, wheelbase
    settle_pose(columns, guesses)
    settle_units(columns, guesses, sizes)
    settle_neutrals(columns, guesses)
    settle_sign(columns, guesses, recordings_of(columns, guesses))
    wheelbase = settle_steering(columns, guesses, vehicle, wheelbase, said)
    if before == ({channel: guess.mapped for channel, guess in guesses.items()}, wheelbase):
      break
  return wheelbase


def settle_neutrals(columns: Columns, guesses: Mapping[str, Guess]) -> None:
  """Count commands from the value under which the car stands, or goes straight on, where that is not 0.

  A duty's full scale then goes from its neutral to its end, as a speed controller's does.
  """
  recordings = recordings_of(columns, guesses)
  drive = next((name for name in DRIVE_COMMANDS if name in guesses), None)
  neutrals = [drive_neutral(recordings, drive) if drive else None, steering_neutral(recordings)]
  for neutral in (n for n in neutrals if n is not None and n.sure):
    guess = guesses[neutral.channel]
    guess.offset -= neutral.value
    if neutral.channel == "motor_duty" and 0.0 < neutral.value < 1.0:
      guess.scale, guess.offset = (number / (1.0 - neutral.value) for number in (guess.scale, guess.offset))
    guess.why.append(f"counted from its neutral: {neutral.why}")


def settle_steering(
  columns: Columns, guesses: dict[str, Guess], vehicle: Vehicle, wheelbase: float, said: float | None = None
) -> float:
  """What a steering command is in, from how the car turned: at small slip yaw rate = speed * angle / wheelbase.

  Of the two that nobody measured, the one moves that is not known: the wheelbase where the angle's unit is, the angle's
  scale else; but the wheelbase again where the angle would then be smaller than any car is steered with. Returns the
  wheelbase, m.
  """
  guess = guesses.get("steering_command")
  if guess is None:
    return wheelbase
  share = not guess.settled and is_share_of_lock(columns.names, columns.values, guess.column, guess.offset)
  if share:
    guess.scale, guess.offset = guess.scale * vehicle.max_steering, guess.offset * vehicle.max_steering
    guess.why.append(f"a share of full lock, {vehicle.max_steering:g} rad")
  guess.settled = True
  turned = Turning.of(recordings_of(columns, guesses), rolling_radius(vehicle))
  alike, angle = turned.alike(_LEAST), turned.gently[1]
  if abs(alike) < _TIED:
    return wheelbase
  ratio, sign = turned.ratio(wheelbase), math.copysign(1.0, alike)
  if not ratio * np.abs(angle).max() < STEEPEST:
    if _NO_ANGLE not in guess.why:
      guess.why.append(_NO_ANGLE)
    return wheelbase
  if sign < 0.0:
    guess.why.append("the car turned the other way")
  known = guess.named or guess.column == guess.channel
  if known and not _SAME_WHEELBASE[0] < ratio < _SAME_WHEELBASE[1]:
    wheelbase = wheelbase / ratio
  elif said is None and not known and _unusual(ratio, angle) and wheelbase / ratio < _LONGEST:
    much = "hardly steer any" if ratio < 1.0 else "steer no"
    guess.why.append(f"as an angle of {ratio * np.abs(angle).max():.2g} rad at most it would {much} car")
    wheelbase = wheelbase / ratio
  elif not known and (share or not _ROAD_ANGLE[0] < ratio < _ROAD_ANGLE[1]):
    guess.why.append(f"a wheelbase of {wheelbase:g} m turns as the car did with {ratio:.2g} times that angle")
    sign *= ratio
  guess.scale, guess.offset = guess.scale * sign, guess.offset * sign
  return wheelbase


def _unusual(ratio: float, angle: Array) -> bool:
  """Whether an angle of a usual size, scaled so, would be none that a car is steered with."""
  usual = np.abs(angle).max()
  return (ratio < _ROAD_ANGLE[0] and ratio * usual < LEAST_LOCK <= usual) or usual <= LOCK < ratio * usual


def usual_gearing(recordings: Sequence[Recording], vehicle: Vehicle, place: bool = True) -> float | None:
  """The gear ratio by which a motor's speed is the one that another sensor measured, or, of a motor's own sensor, the
  `place` went with, at the vehicle's wheel radius; None where they are not alike, or the wheels would turn faster than
  the motor: they are other wheels then."""
  pairs = [_motor_and_car(r, place) for r in recordings if "motor_speed" in r and "motor_speed" not in r.derived]
  if not any(pairs):
    return None
  motor, speed = np.concatenate([np.stack(pair) for pair in pairs if pair is not None], axis=1)
  if abs(correlation(np.abs(motor), np.abs(speed), _ALIKE_ROWS)) < _GEARED:
    return None
  fast = np.isfinite(motor) & np.isfinite(speed) & (np.abs(motor) > 0.5 * np.nanmax(np.abs(motor)))
  ratio = float(np.median(np.abs(speed[fast] / motor[fast])) / vehicle.wheel_radius)
  return ratio if 0.0 < ratio < 1.0 else None


def _motor_and_car(recording: Recording, place: bool) -> tuple[Array, Array] | None:
  """The motor's speed, rad/s, and the car's, m/s: as another sensor measured it, else by the place; None without."""
  if "speed" in recording and "speed" not in recording.derived:
    return recording["motor_speed"].interpolate(recording["speed"].time), recording["speed"].value
  if not place or not {"pose_x", "pose_y"} <= set(recording.channels):
    return None
  bins = Bins(recording)
  return bins.mean("motor_speed"), np.hypot(bins.change("pose_x"), bins.change("pose_y"))
