"""JSON, an object a line: what web services and robots log, and the catalogues of Donkeycar's tubs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.recording import RecordingError

READERS = {".jsonl": "read_json_lines", ".ndjson": "read_json_lines", ".catalog": "read_json_lines"}


def read_json_lines(path: Path, label: str) -> Table:
  """A column for every number of the objects, `imu.gyro.z` where they are nested; blank where an object has none."""
  rows: list[dict[str, float]] = []
  for number, line in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), 1):
    if not line.strip():
      continue
    try:
      said = json.loads(line)
    except (ValueError, RecursionError) as error:
      raise RecordingError(
        f"{label}: line {number} is no JSON ({error}); repair or delete that line (the last one is often cut off when "
        "a logger is killed)"
      ) from error
    if not isinstance(said, dict):
      raise RecordingError(f"{label}: line {number} is no JSON object; write one object a line, with a name per value")
    rows.append(dict(_numbers("", said)))
  names = dict.fromkeys(name for row in rows for name in row)
  columns = {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}
  written = {name: np.array([k for k, r in enumerate(rows) if np.isnan(r.get(name, 0.0))], dtype=int) for name in names}
  return Table(label, columns, written)


def _numbers(before: str, said: dict[str, Any]) -> list[tuple[str, float]]:
  """Names and numbers of an object and of those within it; words are left out."""
  numbers: list[tuple[str, float]] = []
  for key, value in said.items():
    if isinstance(value, dict):
      numbers += _numbers(f"{before}{key}.", value)
    elif isinstance(value, (int, float)):
      numbers.append((f"{before}{key}", float(value)))
    elif isinstance(value, list):
      numbers += [(f"{before}{key}[{k}]", float(v)) for k, v in enumerate(value) if isinstance(v, (int, float))]
  return numbers
