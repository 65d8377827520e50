"""What to say of columns that are no channel and yet matter: brakes, counts of an encoder, numbers that are
written as none are read."""

import re

import numpy as np

from qcar_twin.recordings.first_dataset.columns import Columns
from qcar_twin.recordings.first_dataset.names import readings
from qcar_twin.recordings.first_dataset.scales.brake import PRESSED
from qcar_twin.recordings.first_dataset.scales.counter import adds_up
from qcar_twin.recordings.first_dataset.scales.travel import BRAKES
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import unit_of, words_of

_COUNTERS = {"tick", "ticks", "count", "counts", "pulses", "tachometer", "odometer", "enc", "encoder"}
_A_SECOND = ("/s", "_per_s", "_per_sec", "/sec", " per second")
_ADDS_UP = 0.05  # of all steps, up and down, what a counter that adds up is on by in the end
_MANY = 100  # steps, of a car that drove some metres by any encoder; a counter of laps or of gears has fewer
_DIGITS = re.compile(r"^\s*[-+]?[\d.,]+")


def said_of(columns: Columns, name: str) -> str:
  """What to make of a column that is not used; empty for most."""
  counted = _counter(columns, name) if _counts(columns, name) else ""
  return _brakes(columns, name) or counted or _no_clock(columns, name) or _text(columns, name)


def _text(columns: Columns, name: str) -> str:
  """What keeps a column from being one of numbers, where its cells begin with digits; empty for words and numbers."""
  if name in columns.names or any(other.startswith((f"{name} [", f"{name}.")) for other in columns.names):
    return ""
  for table in columns.holding(name):
    cells = table.columns[name]
    if cells.dtype != object or not all(_DIGITS.match(str(cell)) for cell in cells if cell is not None):
      continue
    try:
      table.number(name, name)
    except RecordingError as error:
      return str(error)
  return ""


def _brakes(columns: Columns, name: str) -> str:
  """What a brake that was used does to a log; empty for any other column."""
  if name not in columns.names or not set(words_of(name)) & BRAKES or columns.constant(name):
    return ""
  values = columns.values(name)
  share = float(np.mean(np.abs(values) > PRESSED * np.abs(values).max()))
  said = f"'{name}' is pressed in {100.0 * share:.0f} % of its rows, and no channel is a brake"
  cure = f'set minus = "{name}" on the drive\'s command in [channels], if it is in one unit with it'
  return f"{said}: cut those seconds out, or {cure}"


def _counts(columns: Columns, name: str) -> bool:
  """Whether a column holds whole numbers, or odometers' metres, over a range that an encoder runs through."""
  return name in columns.names and float(np.ptp(columns.values(name))) >= _MANY


def _counter(columns: Columns, name: str) -> str:
  """What to make of an encoder's counts, which are no speed; empty for any other column, an odometer in km say."""
  words = set(words_of(name))
  if words & {"time", "stamp", "row"} or not (words & _COUNTERS or adds_up(columns, name)):
    return ""
  mapped = f'map it as speed = {{ column = "{name}", scale = … }}, the scale m per step'
  if name.lower().endswith(_A_SECOND):
    return f"'{name}' counts an encoder's steps per second: {mapped}"
  if unit_of(name) is not None:
    return ""
  if _comes_back(columns.values(name)):
    return f"'{name}' seems to count an encoder's steps from row to row: {mapped} times rows per second"
  return (
    f"'{name}' seems to count an encoder's steps, and a speed is their change per second: map it as motor_speed = "
    f'{{ column = "{name}", slope = true, scale = … }}, the scale 2 pi / steps per turn of the motor, or as speed, the '
    "scale m per step"
  )


def _comes_back(values: np.ndarray) -> bool:
  """Whether counts are those since the row before, and go up and down as a speed does; what adds up ends far from where
  it began, or falls all at once where its counter starts again."""
  steps = np.diff(values)
  ends_near = np.abs(np.sum(steps)) < _ADDS_UP * np.sum(np.abs(steps))
  return bool(ends_near and np.abs(steps).max() < 0.5 * np.ptp(values))


def _no_clock(columns: Columns, name: str) -> str:
  """Why a column whose name says time is none; empty for any other, and for a clock beside the one that is used."""
  if name not in columns.names or columns.rises(name) or all(r.channel != "time" for r in readings(name)):
    return ""
  table = next((t for t in columns.tables if name in t), columns.tables[0])
  back = np.flatnonzero(np.diff(table.number(name, name)) < 0.0)
  if back.size:
    row = f"goes back in {back.size} of {table.rows} rows, first row {back[0] + 2} of {table.label}"
    return f"'{name}' says time by its name, and is no clock: it {row}"
  if (count := np.unique(columns.values(name)).size) < columns.values(name).size:
    return f"'{name}' says time by its name, and is no clock: it has {count} values in {table.rows} rows"
  return ""
