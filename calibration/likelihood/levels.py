"""The numbers that decide, read from levels.toml, where each has its source."""

import dataclasses
import tomllib
from pathlib import Path

FILE = Path(__file__).with_name("levels.toml")


@dataclasses.dataclass(frozen=True)
class Levels:
  """Attributes:
  family_wise: share of data sets without an effect on which anything passes by chance.
  draws: random signs of blocks that its level is read from.
  material: share of some channel's squared free-run error that a claim takes off.
  harmless: share by which no channel may get worse in free runs.
  """

  family_wise: float
  draws: int
  material: float
  harmless: float


def levels(file: Path = FILE) -> Levels:
  """The levels of a file.

  Raises:
    ValueError: a level is missing, unknown or without a source.
  """
  table = tomllib.loads(file.read_text(encoding="utf-8"))
  known = {f.name for f in dataclasses.fields(Levels)}
  if set(table) != known:
    raise ValueError(f"{file.name}: levels must be {', '.join(sorted(known))}; it has {', '.join(sorted(table))}")
  for name, entry in table.items():
    if not entry.get("source"):
      raise ValueError(f"{file.name}: level '{name}' has no source; say where its value comes from")
  return Levels(**{name: entry["value"] for name, entry in table.items()})
