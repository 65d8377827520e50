"""The clock of a table that only numbers its rows, where its head states how many there are a second."""

from __future__ import annotations

import dataclasses

import numpy as np

from qcar_twin.recordings.formats.columnar import CLOCKS
from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.recordings.unit_names import unit_of, words_of

_COUNTERS = {"sample", "samples", "frame", "frames", "index", "idx", "row", "counter", "count", "n", "nr", "no", "seq"}
_SECONDS = {"elapsed", "seconds", "secs", "sec", "ms", "millis", "us", "micros"}
_MOSTLY = 0.9  # of a counter's steps, which are one


def with_stated_rate(table: Table, rate: float | None) -> Table:
  """The table with a column `time by sample at 100 Hz [s]`, of the counter `sample` where there is one, else of the
  rows; as it is where no rate in Hz is stated, or a column is a clock by its name or by its unit."""
  if rate is None or any(_is_clock(name) for name in table.columns):
    return table
  counter = next((name for name in table.columns if _counts(table, name)), "")
  number = table.number(counter, "time") if counter else np.arange(table.rows, dtype=float)
  name = f"time by {counter or 'row'} at {rate:g} Hz [s]"
  return dataclasses.replace(table, columns={name: number / rate, **table.columns})


def _is_clock(name: str) -> bool:
  unit = unit_of(name)
  return bool(set(words_of(name)) & (CLOCKS | _SECONDS)) or (unit is not None and unit[1] == "s")


def _counts(table: Table, name: str) -> bool:
  """Whether a column numbers the samples: by its name, and by one from row to row, but where some were lost or a run
  begins."""
  if not set(words_of(name)) & _COUNTERS or name in table.ambiguous:
    return False
  try:
    steps = np.diff(table.number(name, "time"))
  except RecordingError:
    return False
  return bool(steps.size and np.isfinite(steps).all() and np.mean(steps == 1.0) > _MOSTLY)
