"""Whether a log's clock is in seconds, by a gyro and what else turned; a clock by rows, where the rate is said."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.checks.units import UNIT_CORRELATION, compare
from qcar_twin.recordings.completed import heading_or_course
from qcar_twin.recordings.first_dataset.columns import Columns, guess_columns
from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.recording import Recording, RecordingError

_IN_TIME = 1.2  # factor between gyro and turning, within which the clock is right: nearness to a unit
BY_ROW = "time by row [s]"  # stands for `rate` while a first dataset.toml is written


def by_rows(tables: Sequence[Table], rate: float | None) -> list[Table]:
  """Logs without a clock with one, of so many rows a second; as they are without a rate.

  Raises:
    RecordingError: no such rate can be, or they have a clock.
  """
  if rate is None:
    return list(tables)
  if not 0.0 < rate < np.inf:
    raise RecordingError(f"rate must be a positive number, not {rate:g}")
  if (clock := guess_columns(Columns(tables)).get("time")) is not None:
    raise RecordingError(f"{tables[0].label}: '{clock.column}' is the clock; leave the rate out, or that column")
  clocks = [{BY_ROW: np.arange(table.rows) / rate} for table in tables]
  return [
    dataclasses.replace(table, columns={**table.columns, **clock}) for table, clock in zip(tables, clocks, strict=True)
  ]


def rate_of(table: Table) -> float:
  """The rate that was said."""
  return round(1.0 / float(table.columns[BY_ROW][1]), 6)


def in_time(recording: Recording) -> bool:
  """Whether the gyro turns as fast as the heading by the log's clock, or as the path's direction where no heading was
  logged: then neither the clock nor the gyro is in another unit."""
  turning = heading_or_course(recording) if "yaw_rate" in recording else None
  if turning is None:
    return False
  both = recording.replace(streams={"yaw_rate": recording["yaw_rate"], "pose_yaw": turning}, derived=())
  slope, alike = compare(both, {})[0].slope()
  return alike > UNIT_CORRELATION and 1.0 / _IN_TIME < slope < _IN_TIME
