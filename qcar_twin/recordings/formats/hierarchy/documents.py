"""Several recordings, and units of their values, in one JSON document."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.unit_names import BRACKET, VECTORS, unit_of, words_of

_DRIVE = 10  # samples of a recording at least: a sample may hold a short list of objects, what a camera saw say
_DEEPEST = 12  # objects in objects
_NAMES = ("name", "id", "run", "session", "trial", "label")
_UNITS = {"unit", "units"}
_ELEMENT = re.compile(r"^(?P<stem>.*)\[(?P<place>[012])\]$")
Run = Mapping[str, Any] | Sequence[Any]


def runs_in(said: Any, is_clock: Callable[[str], bool]) -> dict[str, Run]:
  """The recordings of a document by name: elements of the only list, or values of the only object of which each holds
  samples; none where there is no such.

  A recording holds a list of ten objects and more, or of as many numbers under a clock's name.
  """
  lists = list(_lists_of_runs(said, is_clock, _DEEPEST))
  return lists[0] if len(lists) == 1 else {}


def _lists_of_runs(said: Any, is_clock: Callable[[str], bool], depth: int) -> Iterator[dict[str, Run]]:
  if depth == 0 or not isinstance(said, (dict, list)) or not said:
    return
  inside = list(said.values()) if isinstance(said, dict) else said
  longest = [_longest(value, is_clock, _DEEPEST) for value in inside]
  by_number = isinstance(said, dict) and len(said) > 1 and len({re.sub(r"\d+", "", key) for key in said}) == 1
  if (isinstance(said, list) or by_number) and min(longest) >= _DRIVE and len(inside) <= max(longest):
    names = list(said) if isinstance(said, dict) else _names(said)
    yield dict(zip(names, inside, strict=True))
    return
  for value in inside if isinstance(said, dict) else ():
    yield from _lists_of_runs(value, is_clock, depth - 1)


def _longest(said: Any, is_clock: Callable[[str], bool], depth: int, name: str = "") -> int:
  """Samples of the longest list that a value holds, or is."""
  if depth == 0:
    return 0
  if isinstance(said, dict):
    return max((_longest(value, is_clock, depth - 1, key) for key, value in said.items()), default=0)
  if not isinstance(said, list) or not said:
    return 0
  numbers = all(isinstance(value, (int, float)) for value in said)
  return len(said) if all(isinstance(value, dict) for value in said) or (numbers and is_clock(name)) else 0


def _names(runs: Sequence[Any]) -> list[str]:
  """What the runs call themselves, where each has a name of its own; else their numbers."""
  for key in _NAMES:
    names = [str(run.get(key, "")) if isinstance(run, dict) else "" for run in runs]
    if all(names) and len(set(names)) == len(names):
      return names
  return [str(number) for number in range(1, len(runs) + 1)]


def units_in(said: Any) -> dict[str, str]:
  """What a document says of units, by the name of a value, as `{"meta": {"units": {"speed": "cm/s"}}}` does."""
  units: dict[str, str] = {}
  for key, value in said.items() if isinstance(said, dict) else ():
    if key.lower() in _UNITS and isinstance(value, dict):
      units |= {name: unit for name, unit in value.items() if isinstance(unit, str) and unit_of(f"[{unit}]")}
    elif isinstance(value, dict):
      units |= units_in(value)
  return units


def with_units(table: Table, units: Mapping[str, str]) -> Table:
  """The table, whose columns have their units behind their names: `imu.gyro.z [mdps]` for the unit of `gyro`. The last
  part of a name that has a unit counts; the elements of a vector of three go by their axes."""
  new = {name: _with_unit(name, table, units) for name in table.columns}
  return dataclasses.replace(
    table,
    columns={new[name]: values for name, values in table.columns.items()},
    not_a_number={new[name]: rows for name, rows in table.not_a_number.items()},
  )


def _with_unit(name: str, table: Table, units: Mapping[str, str]) -> str:
  element = _ELEMENT.match(name)
  parts = (element["stem"] if element else name).split(".")
  unit = units.get(".".join(parts)) or next((units[part] for part in reversed(parts) if part in units), "")
  if not unit or BRACKET.search(_ELEMENT.sub(r"\g<stem>", name)):  # which says a unit itself
    return name
  if element and set(words_of(element["stem"])) & VECTORS and f"{element['stem']}[3]" not in table:
    name = f"{element['stem']}.{'xyz'[int(element['place'])]}"
  return f"{name} [{unit}]"
