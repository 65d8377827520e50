"""Recordings of a data set as MCAP files, with twins and their errors beside what was measured."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.cross_validation.twin_log import UNITS, sources_of
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.mcap_writer import streams_of_table, write_mcap
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.twin.file import command_shift_of, load_twin
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]


def of_log(file: Path, out: Path) -> Path:
  """The columns of any log as topics `/log/column`."""
  return write_mcap(out / f"{file.stem}.mcap", {"log": streams_of_table(read_table(file))}, {"file": file.name})


def of_dataset(
  dataset: DataSet, names: Sequence[str], twins: Mapping[str, tuple[Twin, Array]], window: float, shift: int, out: Path
) -> list[Path]:
  """One file a recording; `names` of recordings, all of them where empty; `window` s between restarts, 0 for none."""
  chosen = [dataset[name] for name in names] or list(dataset.recordings)
  made = []
  for recording in chosen:
    about = {"dataset": dataset.name, "recording": recording.name, "role": recording.role}
    sources = sources_of(recording, twins, window or math.inf, shift)
    made.append(write_mcap(out / f"{recording.name}.mcap", sources, about, UNITS))
  return made


def twin_files(diagnosis: Path | None, before: Path | None, after: Path | None) -> dict[str, Path]:
  """Twin files by what they are called in the MCAP; those of a diagnosis' folder where none is named.

  Raises:
    RecordingError: the folder holds no twin.
  """
  if diagnosis and not (diagnosis / "twin.toml").is_file():
    raise RecordingError(f"{diagnosis}: holds no twin.toml; give the folder that `qcar-twin diagnose --out` wrote")
  files = {
    "before": before or (diagnosis and diagnosis / "recalibrated.toml"),
    "after": after or (diagnosis and diagnosis / "twin.toml"),
  }
  return {name: path for name, path in files.items() if path}


def loaded(files: Mapping[str, Path]) -> dict[str, tuple[Twin, Array]]:
  """The twins of some files."""
  return {name: load_twin(path, threads=1) for name, path in files.items()}


def fitted_shift(*twins: Path | None) -> int:
  """The timing that was fitted with the first of these twins that there is; 0 without any."""
  return next((command_shift_of(twin) for twin in twins if twin), 0)
