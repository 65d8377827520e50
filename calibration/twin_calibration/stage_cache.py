"""Results of the stages of a long run, kept as JSON so that a broken-off run goes on where it was.

  stages = Stages(out / "stages", fingerprint(dataset), options)
  fitted = stages.kept("identify") or stages.keep("identify", work())

A stage counts only for the same recordings, options and program; anything else is computed again.
"""

import functools
import hashlib
import logging
import os
from pathlib import Path
from typing import Any

import numpy as np

from qcar_twin.atomic_io import write_json
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.untrusted import read_json
from qcar_twin.vehicle.vehicle import ASSETS

log = logging.getLogger(__name__)


class Stages:
  """A folder of stage results, or none at all where `folder` is None."""

  def __init__(self, folder: str | os.PathLike[str] | None, *key: Any):
    """key: everything the results depend on; compared by value."""
    self._folder = None if folder is None else Path(folder)
    self._key = hashlib.sha256(repr((program(), key)).encode()).hexdigest()

  def kept(self, name: str) -> Any | None:
    """Result of a finished stage with the same key; None if there is none."""
    if self._folder is None or not (path := self._folder / f"{name}.json").is_file():
      return None
    try:
      stored = read_json(path)
    except ValueError:
      log.warning("%s is not readable: the stage is done again", path.name)
      return None
    if stored.get("key") != self._key:
      return None
    log.info("stage '%s' taken from %s", name, path)
    return stored["result"]

  def keep(self, name: str, result: Any) -> Any:
    """Store a finished stage (plain JSON types; NaN becomes null) and return it."""
    if self._folder is not None:
      write_json(self._folder / f"{name}.json", {"key": self._key, "result": result})
    return result


@functools.cache
def program() -> str:
  """SHA-256 of the sources that results depend on."""
  root = Path(__file__).resolve().parents[2]
  digest = hashlib.sha256()
  for folder in (root / "qcar_twin", root / "calibration", ASSETS):
    for path in sorted(folder.rglob("*")):
      if path.suffix in (".py", ".c", ".xml", ".toml"):
        digest.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
  return digest.hexdigest()


def fingerprint(dataset: DataSet) -> str:
  """SHA-256 of a data set's recordings and vehicle numbers."""
  digest = hashlib.sha256(repr((dataset.command_timing, dataset.vehicle, dataset.vehicle_std)).encode())
  for recording in dataset.recordings:
    digest.update(
      repr((recording.name, recording.role, recording.manoeuvre, recording.session, recording.before)).encode()
    )
    for name in recording.channels:
      stream = recording[name]
      digest.update(name.encode())
      digest.update(np.ascontiguousarray(stream.time).tobytes())
      digest.update(np.ascontiguousarray(stream.value).tobytes())
  return digest.hexdigest()
