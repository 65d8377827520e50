"""Negative whole numbers that a logger wrote as if they had no sign: -1000 as 4294966296."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from qcar_twin.recordings.formats.table import Table

_BITS = (16, 32)
_NEAR = 8  # a range's part next to either of its ends; a number that runs through all of it is none with a sign
_LEAST = 2  # samples at either end


def signed(table: Table) -> Table:
  """The table with a sign on whole numbers of 16 or 32 bit that lie next to both ends of their range and nowhere else,
  and which columns they are."""
  made, bits = {}, {}
  for name, values in table.columns.items():
    width = _bits(values) if values.dtype != object else 0
    if width:
      made[name] = np.where(values >= 2.0 ** (width - 1), values - 2.0**width, values)
      bits[name] = width
  return dataclasses.replace(table, columns={**table.columns, **made}, unsigned=bits) if made else table


def signs_said(table: Table, columns: Mapping[str, str]) -> list[str]:
  """Notes on the columns, by channel, whose numbers got their sign back."""
  return [
    f"{table.label}: column '{column}' for {channel} has negative numbers of {bits} bit without their sign; they are"
    " read with it"
    for channel, column in columns.items()
    if (bits := table.unsigned.get(column))
  ]


def _bits(values: np.ndarray) -> int:
  """Width of the numbers that lost their sign; 0 of any others."""
  known = values[np.isfinite(values)]
  if not known.size or known.min() < 0.0 or not np.array_equal(known, np.floor(known)):
    return 0
  for width in _BITS:
    whole, high = 2.0**width, known >= 2.0 ** (width - 1)
    edge = whole / _NEAR
    if high.sum() >= _LEAST and (~high).sum() >= _LEAST and known.max() < whole:
      return width if known[high].min() >= whole - edge and known[~high].max() <= edge else 0
  return 0
