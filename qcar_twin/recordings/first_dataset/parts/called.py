"""What recordings are called: each after its file, and after what tells it from others where files are called alike."""

import dataclasses
import re
from collections.abc import Sequence
from pathlib import PurePosixPath

from qcar_twin.recordings.first_dataset.roles import Part


def told_apart(parts: Sequence[Part]) -> list[Part]:
  """The same recordings, with a name where the loader would call two alike: `tub_1` and `tub_2` of
  `tub_1/catalog_0.csv` and `tub_2/catalog_0.csv`."""
  names = _names([part.file for part in parts])
  stems = {part.file: PurePosixPath(part.file).stem for part in parts}
  out = []
  for part in parts:
    name, stem = names[part.file], stems[part.file]
    if name != stem:
      rest = part.name.removeprefix(stem) if part.name else "" if part.begin is None else f"_{part.begin:g}s"
      part = dataclasses.replace(part, name=f"{name}{rest}")
    out.append(part)
  return out


def _names(files: Sequence[str]) -> dict[str, str]:
  """By file its stem; of files whose stems are alike the folders that differ, the whole path where that tells none."""
  alike: dict[str, list[str]] = {}
  for file in dict.fromkeys(files):
    alike.setdefault(PurePosixPath(file).stem, []).append(file)
  names = {}
  for stem, group in alike.items():
    paths = {file: PurePosixPath(file).parts for file in group}
    shared = set.intersection(*(set(path) for path in paths.values()))
    own = {file: _name([part for part in path[:-1] if part not in shared]) for file, path in paths.items()}
    whole = {file: _name(path) for file, path in paths.items()}
    told = own if all(own.values()) and len({*own.values()}) == len(own) else whole
    names |= told if len(group) > 1 else {group[0]: stem}
  if len({*names.values()}) < len(names):  # a folder is called as another file
    names = {file: _name(PurePosixPath(file).parts) for file in names}
  return names


def _name(parts: Sequence[str]) -> str:
  """Parts of a path as one name, which has no leading dot, as a hidden file's has."""
  return re.sub(r"^\.+", "", "_".join(parts))
