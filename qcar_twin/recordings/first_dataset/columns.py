"""Which column of some logs is which channel, in which unit: by its name first, then by what its values can be."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.clock_units import LONGEST_STEP, TIMES, unit_of_clock
from qcar_twin.recordings.first_dataset.names import Reading, readings
from qcar_twin.recordings.first_dataset.scales.series import behind, usual_run
from qcar_twin.recordings.first_dataset.scales.travel import LOCK, hundreds, is_pulse, travel_of
from qcar_twin.recordings.formats import Table
from qcar_twin.recordings.formats.axles import of_wheels
from qcar_twin.recordings.formats.composed import parts_of_others
from qcar_twin.recordings.manifest import Mapped
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import UNITS, is_electrical, unit_of, words_of
from qcar_twin.vehicle.vehicle import QCAR

Array = NDArray[np.float64]

_CLOCK_UNITS = {"us", "µs", "ms", "millis", "micros"}  # that are a counter's name, which may begin again
_COUNTED = 2.0  # of a name's score: more than a second word that fits
_LEAST = 10  # repeated stamps, from which a habit of the log is read
_TICKS = 0.05  # share of rows in which a clock that a slower publisher holds has moved on
_LATE_ROWS = 0.01  # share of rows that a logger of several threads writes out of order
_USED = 0.02  # of full duty, which no car is driven with at most: so little is no per cent
_GATES = {"armed", "arm", "safety", "enable", "enabled", "deadman", "active", "switch", "autonomous"}
_COMMANDED, _FEW_STEPS = 20.0, 3  # rows for which a command stays, median, and how often it has to step
_EVEN, _MOSTLY = 0.5, 0.8  # share of the usual step that a clock's have at least, and how many of them
_STEPS = {"dt", "deltat", "timestep"}
_POLE_PAIRS = 2.0  # of most motors of 1:10 cars; `new` asks
_HAND_TURNS = 16.0  # angle of the steering wheel by that of the road wheels: 12 to 20 of passenger cars
_HAND_WHEEL = {"steering", "wheel"}  # what a driver turns, many times as far as the road wheels
_ANY_ANGLE = math.degrees(LOCK) * _HAND_TURNS  # deg, beyond which no steering wheel is turned
_MOST_FELT = 4.0  # g: tyres hold 1 to 2, and of a hundred readings one may be a bump
_HELD = 2.0  # rows for which a value stays, median, from which a faster log repeats a slower sensor


@dataclasses.dataclass
class Guess:
  """One channel's column. `why` are the reasons for it, each a clause; `named`: its name, or gravity, says the unit;
  `settled`: a share of lock was scaled to an angle."""

  channel: str
  column: str
  scale: float = 1.0
  offset: float = 0.0
  wrap: bool | None = None
  hold: bool = False
  gate: str | None = None
  signed_by: str | None = None
  minus: str | None = None
  steps: bool = False
  sort: bool = False
  named: bool = False
  settled: bool = False
  why: list[str] = dataclasses.field(default_factory=list)

  def reverse(self, why: str) -> None:
    """Count the other way, for a reason."""
    self.scale, self.offset = -self.scale, -self.offset
    self.why.append(why)

  @property
  def mapped(self) -> Mapped:
    """As [channels] has it."""
    fields = (field.name for field in dataclasses.fields(Mapped))
    return Mapped(**{name: getattr(self, name) for name in fields if hasattr(self, name)})


class Columns:
  """The columns of several logs, as numbers. A sensor's with a few words in it ("ERR") is one all the same.

  `gear_ratio`: turns of a wheel per turn of the motor, where a person says it.
  """

  def __init__(self, tables: Sequence[Table], gear_ratio: float | None = None):
    """Raises RecordingError: a column whose name means a channel occurs more than once, with other values."""
    for table in tables:
      if twice := [name for name in table.columns if name in table.ambiguous and readings(name)]:
        raise RecordingError(f"{table.label}: column '{twice[0]}' occurs more than once; rename or remove all but one")
    self.gear_ratio = gear_ratio
    self.tables = [table.mostly_numbers() for table in tables]
    parts = {name for table in tables for name in parts_of_others(table.columns)}
    named = dict.fromkeys(name for table in tables for name in table.columns if name not in parts)
    self.names = tuple(name for name in named if self._numeric(name))

  def _numeric(self, name: str) -> bool:
    try:
      return all(np.isfinite(table.number(name, name)).any() for table in self.holding(name))
    except RecordingError:
      return False

  def holding(self, name: str) -> list[Table]:
    """The logs that have a column."""
    return [table for table in self.tables if name in table]

  def values(self, name: str) -> Array:
    """All values of a column that are there, one log after the other."""
    values = np.concatenate([table.number(name, name) for table in self.holding(name)])
    return values[np.isfinite(values)]

  def constant(self, name: str) -> bool:
    """Whether a column never changes, in any log."""
    values = self.values(name)
    return bool(np.ptp(values) == 0.0)

  def rises(self, name: str, late: float = 0.0) -> bool:
    """Whether a column is in every log, has a value in every row and goes on as a clock does: at most a share `late` of
    its rows is behind an earlier one, and it has many values."""
    if len(self.holding(name)) < len(self.tables):
      return False
    steps = [np.diff(table.number(name, name)) for table in self.tables]
    return all(
      step.size and np.isfinite(step).all() and behind(step) <= late * step.size and np.mean(step > 0.0) > _TICKS
      for step in steps
    )

  def evenly(self, name: str) -> bool:
    """Whether a column that rises has much the same step in most rows, as a clock does and a car's speed does not."""
    steps = np.concatenate([np.diff(table.number(name, name)) for table in self.tables])
    steps = steps[steps > 0.0]
    usual = np.median(steps)
    return bool(np.mean((steps > _EVEN * usual) & (steps < usual / _EVEN)) > _MOSTLY)

  def mostly_forward(self, name: str) -> bool:
    """Whether a clock goes back in a few rows of a log at most."""
    values = [table.number(name, name) for table in self.holding(name)]
    steps = [np.diff(each[np.isfinite(each)]) for each in values]
    return all(np.sum(step < 0.0) <= _LATE_ROWS * step.size for step in steps)

  def counts(self, name: str) -> bool:
    """Whether a column numbers the rows."""
    return all((np.diff(table.number(name, name)) == 1.0).all() for table in self.tables)

  def steps(self, name: str) -> bool:
    """Whether a column has the time since the row before in every row: positive, and much the same; one that only ever
    rises is a clock of few digits."""
    if len(self.holding(name)) < len(self.tables):
      return False
    rising = [np.diff(table.number(name, name)) for table in self.tables]
    if all((step >= 0.0).all() for step in rising) and not self.constant(name):
      return False
    values = self.values(name)
    low, usual, high = np.percentile(values, [5, 50, 95])
    even = values.min() >= 0.0 and usual > 0.0 and 0.3 * usual < low <= high < 3.0 * usual
    return bool(even and usual * TIMES[-1][0] <= LONGEST_STEP)

  def top(self, name: str) -> float:
    """The largest magnitude, without one in a thousand."""
    return float(np.percentile(np.abs(self.values(name)), 99.9))


def guess_columns(columns: Columns) -> dict[str, Guess]:
  """Guesses by channel, each column once: names first, best fit first; then units by name and by value."""
  offers = []
  for place, name in enumerate(columns.names):
    everywhere = 0.5 * (len(columns.holding(name)) == len(columns.tables))
    for reading in (*_of_a_message(columns, name), *readings(name)):
      if possible(columns, name, reading.channel):
        against = stepped(columns, name, reading.channel) + _too_fast(columns, name, reading.channel)
        offers.append((reading.score + everywhere - against, -place, reading, name))
  guesses: dict[str, Guess] = {}
  for _, _, reading, name in sorted(offers, key=lambda offer: offer[:2], reverse=True):
    if reading.channel not in guesses and name not in {guess.column for guess in guesses.values()}:
      guesses[reading.channel] = Guess(reading.channel, name, why=[reading.why])
  if "time" not in guesses and (clock := _clock(columns)) is not None:
    guesses["time"] = clock
  for guess in guesses.values():
    scale(columns, guess)
  hold(columns, guesses)
  gate(columns, guesses)
  return {channel: guesses[channel] for channel in CHANNELS if channel in guesses}


def _of_a_message(columns: Columns, name: str) -> list[Reading]:
  """ROS' AckermannDrive is a command: its speed lies beside its steering_angle, `/drive/drive/speed`."""
  stem, beside = words_of(name)[:-1], [words_of(other) for other in columns.names]
  if words_of(name)[-1:] != ("speed",) or not stem or (*stem, "steering", "angle") not in beside:
    return []
  return [Reading("speed_command", 3.0, "it lies beside a steering angle, as in a message that commands both")]


def _clock(columns: Columns) -> Guess | None:
  """A clock whose name says time and that some rows were written late in, or whose steps it has; else one that rises,
  whatever it is called, but no numbers of the rows: what counts them by ones says a unit of time where it is one."""
  clock = lambda name: any(reading.channel == "time" for reading in readings(name)) or name.lower() in _CLOCK_UNITS
  named = [name for name in columns.names if clock(name)]
  for name in named:
    if columns.rises(name, _LATE_ROWS):
      late = sum(behind(np.diff(table.number(name, name))) for table in columns.tables)
      rows = f"; {late} of {columns.values(name).size} rows are out of order" if late else ""
      return Guess("time", name, sort=late > 0, why=[f"its name says time{rows}"])
  for name in named:
    if columns.rises(name, 1.0) and columns.mostly_forward(name):
      return Guess("time", name, why=["its name says time; it goes back where a logger began again"])
  for name in (*named, *(name for name in columns.names if set(words_of(name)) & _STEPS)):
    if columns.steps(name):
      return Guess("time", name, steps=True, why=["its name says time, and it has the steps from row to row"])
  in_time = lambda name: (unit := unit_of(name)) is not None and unit[1] == "s"
  numbers = lambda name: columns.counts(name) and not in_time(name) and name.lower() not in UNITS
  rising = [name for name in columns.names if columns.rises(name) and columns.evenly(name) and not numbers(name)]
  return Guess("time", rising[0], why=["it rises through every file"]) if rising else None


def stepped(columns: Columns, name: str, channel: str) -> float:
  """What a column loses as a speed where it stays for long and steps: that is what was commanded, not what was done."""
  if channel not in ("speed", "motor_speed"):
    return 0.0
  stays = usual_run([table.number(name, name) for table in columns.holding(name)], _FEW_STEPS)
  return 0.1 if stays >= _COMMANDED else 0.0


def _too_fast(columns: Columns, name: str, channel: str) -> float:
  """What a column loses as a speed where no usual unit makes it one of a car: counts a second of an encoder, say."""
  if channel != "speed" or unit_of(name) is not None:
    return 0.0
  least = min(factor for _, factor in CHANNELS[channel].log_units)
  return _COUNTED if least * columns.top(name) > CHANNELS[channel].limit else 0.0


def possible(columns: Columns, name: str, channel: str) -> bool:
  """Whether the values do not forbid it: a clock rises, a channel changes and is no clock by its name that goes on. A
  wheel's angle that only grows, beyond any steering wheel's, is that of its turning."""
  if channel == "time":
    return columns.rises(name)
  goes_on = any(reading.channel == "time" for reading in readings(name))
  goes_on |= channel == "steering_command" and columns.top(name) > _ANY_ANGLE
  return not columns.constant(name) and not (goes_on and columns.mostly_forward(name))


def scale(columns: Columns, guess: Guess) -> None:
  """The factor to SI, by the unit in the name or by the size of the values, from scratch."""
  guess.scale, guess.offset, guess.named = 1.0, 0.0, False
  channel, unit, top = CHANNELS[guess.channel], unit_of(guess.column), columns.top(guess.column)
  if unit is not None and guess.channel == "yaw_rate" and unit[0].lower() == "rps":  # of wheels it is turns
    guess.why.append("rps of a gyro are radians per second")
  elif unit is not None and unit[1] == channel.unit:
    guess.scale, guess.named = unit[2], True
    guess.why.append(f"in {unit[0]}")
    if guess.channel == "steering_command" and (
      set(words_of(guess.column)) >= _HAND_WHEEL or top * unit[2] > channel.limit
    ):
      guess.named = False
      guess.why.append("an angle of the steering wheel, not of the road wheels")
      if top * unit[2] > LOCK:
        guess.scale /= _HAND_TURNS
        guess.why.append(f"usual cars' road wheels turn by 1/{_HAND_TURNS:g} of it")
    if guess.channel == "motor_speed" and is_electrical(guess.column):
      guess.scale *= (hundred := hundreds(columns.names, guess.column)) / _POLE_PAIRS
      guess.why += ["in hundreds, as Betaflight's blackbox has it"] if hundred > 1.0 else []
      guess.why.append(f"of the field, which turns {_POLE_PAIRS:g} times as fast as a motor of 4 poles")
  elif guess.channel == "speed_command" and unit is not None and unit[1] == CHANNELS["motor_speed"].unit:
    guess.scale, guess.named = unit[2] / (_POLE_PAIRS if is_electrical(guess.column) else 1.0), True
    guess.why.append(f"in {unit[0]}")
  elif guess.channel == "time":
    _scale_time(columns, guess)
  elif guess.channel == "steering_command" and unit is not None and unit[1] == "-":
    guess.scale = unit[2]
    guess.why.append(f"in {unit[0]} of full travel")
  elif (travel := travel_of(columns.names, columns.values, guess.channel, guess.column)) is not None:
    guess.scale = travel[0]
    guess.why.append(travel[1])
  elif guess.channel in ("motor_duty", "steering_command") and is_pulse(columns.values(guess.column)):
    guess.scale, guess.offset = 1.0 / 500.0, -3.0
    guess.why.append("values around 1500 are a servo's pulse in us, 500 to full travel")
  elif top > channel.limit:
    least = _USED * channel.limit if guess.channel == "motor_duty" else 0.0
    usual = [(name, factor) for name, factor in channel.log_units if least < top * factor < channel.limit]
    jolts = 1e-3 * float(np.percentile(np.abs(columns.values(guess.column)), 99.0))
    if usual and usual[0][0] == "mg" and jolts > _MOST_FELT:
      guess.why.append(f"it would often reach {jolts:.2g} g in mg, more than a car feels: counts of an unknown size")
    elif usual:
      guess.scale = usual[0][1]
      guess.why.append(f"it reaches {top:.3g}, too much for {channel.unit}, so in {usual[0][0]}")
  if guess.channel == "motor_speed" and of_wheels(guess.column):
    guess.scale /= (ratio := columns.gear_ratio or QCAR.gear_ratio)
    known = ", as said" if columns.gear_ratio else ": correct both by yours"
    guess.why.append(f"of a wheel, which a motor turns by gear_ratio = {ratio:g}{known}")


def _scale_time(columns: Columns, guess: Guess) -> None:
  number = lambda table: table.number(guess.column, "time")
  steps = [number(table) if guess.steps else np.diff(number(table)) for table in columns.tables]
  step = float(np.median(np.concatenate([each[each > 0.0] for each in steps])))
  if (read := unit_of_clock(guess.column, step, columns.top(guess.column))) is not None:
    guess.scale = read[0]
    guess.why.append(f"steps of {step:g} are a log's in {read[1]}")


def hold(columns: Columns, guesses: Mapping[str, Guess]) -> None:
  """`hold` for the columns that repeat a slower sensor's sample over several rows."""
  if "time" not in guesses:
    return
  clock = guesses["time"].column
  if guesses["time"].steps:
    return
  repeats = [table for table in columns.tables if (np.diff(table.number(clock, "time")) == 0.0).any()]
  for guess in guesses.values():
    if guess.channel == "time":
      continue
    among = [_repeated(table, clock, guess.column) for table in repeats if guess.column in table]
    if sum(map(len, among)) >= _LEAST and not any(changed.any() for changed in among):
      guess.hold = True
      guess.why.append("it never changes while the time stamp repeats")
    elif not repeats and CHANNELS[guess.channel].kind == "sensor":
      stays = usual_run([table.number(guess.column, guess.column) for table in columns.holding(guess.column)])
      if stays >= _HELD:
        guess.hold = True
        guess.why.append(f"a value usually stays for {stays:.0f} rows")


def _repeated(table: Table, clock: str, column: str) -> NDArray[np.bool_]:
  """Whether each sample differs from the one before, where both have one time stamp; rows of one stamp without a
  value, as of another topic, tell nothing."""
  values = table.number(column, column)
  both = (np.diff(table.number(clock, "time")) == 0.0) & np.isfinite(values[1:]) & np.isfinite(values[:-1])
  return values[1:][both] != values[:-1][both]


def gate(columns: Columns, guesses: Mapping[str, Guess]) -> None:
  """A switch that the drive's command has to pass, where one was logged and was ever off under a command."""
  drives = [
    guesses[name]
    for name in ("motor_voltage", "motor_duty", "motor_current", "acceleration_command")
    if name in guesses
  ]
  taken = {guess.column for guess in guesses.values()}
  for name in columns.names:
    switch = name not in taken and set(words_of(name)) & _GATES and set(np.unique(columns.values(name))) == {0.0, 1.0}
    if not switch or not drives:
      continue
    pairs = [
      (t.number(name, name), t.number(drives[0].column, "drive"))
      for t in columns.holding(name)
      if drives[0].column in t
    ]
    blocked = sum(int(np.sum((on == 0.0) & (np.abs(command) > 0.0))) for on, command in pairs)
    if blocked and len(pairs) == len(columns.tables):
      drives[0].gate = name
      drives[0].why.append(f"'{name}' is 0 or 1, and 0 in {blocked} rows with a command")
      return
