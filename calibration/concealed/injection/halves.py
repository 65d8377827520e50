"""A data set in two halves between which nothing was changed: whatever is said to differ is false."""

from __future__ import annotations

import numpy as np

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording

FEWEST = 8  # recordings below which they are cut into pieces
SHORTEST = 6.0  # s of a piece


def halves(dataset: DataSet, rng: np.random.Generator) -> tuple[DataSet, DataSet]:
  """Two data sets of half the recordings each, drawn within each kind of manoeuvre; few long ones are cut first.

  Hold-out recordings stay out. Both halves have recordings that identify.

  Raises:
    ValueError: less than four pieces can be made.
  """
  pieces = [r for r in dataset.recordings if r.role != "holdout"]
  if len(pieces) < FEWEST:
    pieces = [piece for recording in pieces for piece in _cut(recording, FEWEST)]
  if len(pieces) < 4:
    raise ValueError(f"data set {dataset.name}: {len(pieces)} pieces of {SHORTEST:g} s and more are too few for halves")
  kinds: dict[tuple[str, str], list[Recording]] = {}
  for piece in pieces:
    kinds.setdefault((piece.role, piece.manoeuvre), []).append(piece)
  parts: tuple[list[Recording], list[Recording]] = ([], [])
  for _, group in sorted(kinds.items()):
    shorter = int(len(parts[0]) > len(parts[1]))
    for place, index in enumerate(rng.permutation(len(group))):
      parts[(place + shorter) % 2].append(group[index])
  return _set(dataset, "first", parts[0]), _set(dataset, "second", parts[1])


def _cut(recording: Recording, most: int) -> list[Recording]:
  """Pieces of equal length, none shorter than SHORTEST."""
  count = max(1, min(most, int(recording.duration / SHORTEST)))
  edges = np.linspace(recording.start, recording.end, count + 1)
  pieces = zip(edges[:-1], edges[1:], strict=True)
  return [
    recording.window(low, high).replace(name=f"{recording.name}_{i}") for i, (low, high) in enumerate(pieces)
  ]  # fmt: skip


def _set(dataset: DataSet, which: str, parts: list[Recording]) -> DataSet:
  if all(part.role != "identify" for part in parts):
    parts = [part.replace(role="identify") for part in parts]
  order = {recording.name: i for i, recording in enumerate(dataset.recordings)}
  parts = sorted(parts, key=lambda r: (order.get(r.name, len(order)), r.start))
  name = f"{dataset.name}_{which}"
  return DataSet(name, tuple(parts), dataset.vehicle, dataset.vehicle_std, "", dataset.command_timing)
