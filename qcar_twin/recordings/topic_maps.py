"""Ready-made maps from the topics of known cars to channels, by name: `map = "f1tenth"` in dataset.toml."""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from qcar_twin.recordings.manifest import Mapped
from qcar_twin.recordings.recording import RecordingError, nearest

_FILE = Path(__file__).with_name("topic_maps.toml")
_ANY = "*"


@dataclass(frozen=True)
class TopicMap:
  """One map.

  Attributes:
    about: what writes such logs.
    choices: channel -> columns to try in order, and how one becomes the channel.
    vehicle: what is known of the car, as [vehicle] of a dataset.toml has it.
  """

  name: str
  about: str
  choices: Mapping[str, tuple[tuple[str, ...], Mapped]]
  vehicle: Mapping[str, float | str]

  def mapping(self, columns: Iterable[str], label: str, given: Iterable[str] = ()) -> dict[str, Mapped]:
    """The channels of one file, as far as it has their columns.

    Args:
      columns: of the file.
      label: the file's name in errors.
      given: channels that the data set maps itself, which are left out.

    Raises:
      RecordingError: two topics could be meant, or the file has none of those the map knows.
    """
    there, given, mapping = tuple(columns), frozenset(given), {}
    for channel, (wanted, how) in self.choices.items():
      if channel in given:
        continue
      match = next((fits for column in wanted if (fits := _matches(column, there))), ())
      if len(match) > 1:
        raise RecordingError(
          f"{label}: map '{self.name}' finds {channel} in several topics ({', '.join(match)}); say which in "
          f'[channels]: {channel} = {{ column = "{match[0]}" }}'
        )
      if match:
        mapping[channel] = Mapped(match[0], how.scale, how.offset, how.wrap)
    if not mapping and not given:
      known = ", ".join(dict.fromkeys(column for wanted, _ in self.choices.values() for column in wanted))
      raise RecordingError(
        f"{label}: map '{self.name}' finds none of its columns ({known}); choose another map, or write [channels]. "
        f"Columns that exist: {', '.join(there[:40])}"
      )
    return mapping


def _matches(column: str, there: tuple[str, ...]) -> tuple[str, ...]:
  if column.startswith(_ANY):
    return tuple(name for name in there if name.endswith(column[1:]))
  return (column,) if column in there else ()


@functools.cache
def topic_maps() -> dict[str, TopicMap]:
  """Every map by name, as topic_maps.toml has them."""
  maps = {}
  for name, table in tomllib.loads(_FILE.read_text(encoding="utf-8")).items():
    choices = {
      channel: (tuple(entry.pop("columns")), Mapped("", **entry)) for channel, entry in table["channels"].items()
    }
    maps[name] = TopicMap(name, table["about"], choices, table.get("vehicle", {}))
  return maps


def topic_map(name: str) -> TopicMap:
  """The map of this name; RecordingError names the nearest one."""
  if name not in topic_maps():
    raise RecordingError(f"dataset.toml: unknown map '{name}'{nearest(name, topic_maps())}")
  return topic_maps()[name]
