"""Parts of a long benchmark, each a line of NDJSON when it is done; those that are there are not done again."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from calibration.progress import counted
from qcar_twin.atomic_io import plain, write_text

Part = tuple[Mapping[str, Any], Callable[[], Mapping[str, Any]]]
"""What tells a part from all others, for JSON, and what does it; both together are its line."""


def kept(path: Path, parts: Sequence[Part]) -> list[dict[str, Any]]:
  """Lines of all parts in their order; `path` gets each as it is done, and the terminal how many are left.

  Lines of other parts stay in the file. Half a line at its end, of a run that was killed, is cut.
  """
  text = path.read_text(encoding="utf-8") if path.is_file() else ""
  whole = text[: text.rfind("\n") + 1]
  write_text(path, whole)
  known = [json.loads(line) for line in whole.splitlines()]
  return list(counted((_line(path, known, *part) for part in parts), len(parts), "part"))


def _line(
  path: Path, known: Sequence[dict[str, Any]], key: Mapping[str, Any], act: Callable[[], Mapping[str, Any]]
) -> dict[str, Any]:
  """A part's line, from the file where it is there."""
  for line in known:
    if all(line.get(name) == value for name, value in key.items()):
      return line
  line = json.loads(json.dumps(plain({**key, **act()}), allow_nan=False))
  with path.open("a", encoding="utf-8") as file:
    file.write(json.dumps(line) + "\n")
  return line
