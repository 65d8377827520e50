"""The page of a log that cannot be read as a drive yet: why, what was guessed, and every column as it is."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from qcar_twin.pages import Cell, Explorer, Line, Panel, Run, Section, Table, write_page
from qcar_twin.recordings.first_dataset.columns import Columns
from qcar_twin.recordings.formats import Table as Log

_PANELS = 16  # columns that are drawn


def write_raw(logs: Sequence[Log], why: str, guesses: Sequence[str], folder: str | os.PathLike[str]) -> Path:
  """Write log.html; returns its path.

  Args:
    logs: as they were read.
    why: they cannot be read as a drive, with the cure.
    guesses: lines of [channels].
  """
  columns = Columns(logs)
  drawn = [name for name in columns.names if not columns.constant(name)][:_PANELS]
  runs = [Run(log.label, [_panel(log, name) for name in drawn if name in log]) for log in logs]
  rows: list[Sequence[Cell]] = []
  for name in columns.names:
    values = columns.values(name)
    rows.append([name, len(values), float(values.min()), float(np.median(values)), float(values.max())])
  sections = [
    Section("What was guessed", "\n".join(f"* {line}" for line in guesses)),
    Section("The columns", "Against the row's number.", figures=[Explorer("Every column that changes.", runs)]),
    Section("Ranges", "", [Table("Columns", ("column", "values", "least", "median", "largest"), rows)]),
  ]
  subtitle = ", ".join(log.label for log in logs[:4])
  return write_page(Path(folder) / "log.html", "The log", f"Not readable as a drive yet: {why}", sections, subtitle)


def _panel(log: Log, name: str) -> Panel:
  values = log.number(name, name)
  return Panel(name, [Line("measured", np.arange(len(values), dtype=float), values, name)])
