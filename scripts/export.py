"""Write recordings, twins and their errors as MCAP for Foxglove, PlotJuggler and Rerun.

One file per recording: /measured, /before, /after, and /error_before, /error_after with forces.

qcar-twin export --dataset data/sample --diagnosis out/diagnosed --out out/mcap
qcar-twin export --log out/tracked/traces.csv --out out/mcap
"""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np

from calibration.cross_validation.twin_log import UNITS, sources_of
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.mcap_writer import streams_of_table, write_mcap
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.twin.file import load_twin
from qcar_twin.twin.twin import Twin


@dataclasses.dataclass(frozen=True)
class Config:
  """Recordings or a log, and the twins to compare them with."""

  out: Path
  """Folder for one MCAP file per recording; files of the same name are replaced."""
  dataset: Path | None = None
  """Folder with dataset.toml, in SI units."""
  recordings: tuple[str, ...] = ()
  """Names of recordings; all of them where not given."""
  diagnosis: Path | None = None
  """Folder that diagnose wrote: its recalibrated twin becomes `before`, its repaired twin `after`."""
  before: Path | None = None
  """Twin file shown as `before`."""
  after: Path | None = None
  """Twin file shown as `after`."""
  window: float = 6.0
  """Time between restarts of the twins from the measured state, s; 0 for one free run."""
  command_shift: int | None = None
  """Delay of commands against the log, control periods of 10 ms. Where not given, calibration.json next to the twin
  decides, else 0."""
  log: Path | None = None
  """Any other readable log, such as traces.csv of track: its columns are written as they are."""


def main(config: Config) -> list[Path]:
  """Write the files and print their names; returns them."""
  if (config.dataset is None) == (config.log is None):
    raise ValueError("give either --dataset, a folder with dataset.toml, or --log, one file")
  made = [of_log(config.log, config.out)] if config.log else of_dataset(config)
  for path in made:
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")
  return made


def of_log(file: Path, out: Path) -> Path:
  """The columns of any log as topics `/log/column`."""
  return write_mcap(out / f"{file.stem}.mcap", {"log": streams_of_table(read_table(file))}, {"file": file.name})


def of_dataset(config: Config) -> list[Path]:
  """One file a recording."""
  assert config.dataset is not None
  dataset, twins = DataSet.load(config.dataset), twins_of(config)
  chosen = [dataset[name] for name in config.recordings] or list(dataset.recordings)
  shift = fitted_shift(config) if config.command_shift is None else config.command_shift
  made = []
  for recording in chosen:
    about = {"dataset": dataset.name, "recording": recording.name, "role": recording.role}
    sources = sources_of(recording, twins, config.window or math.inf, shift)
    made.append(write_mcap(config.out / f"{recording.name}.mcap", sources, about, UNITS))
  return made


def twins_of(config: Config) -> dict[str, tuple[Twin, np.ndarray]]:
  """Twins by what they are called in the file."""
  folder = config.diagnosis
  if folder and not (folder / "twin.toml").is_file():
    raise RecordingError(f"{folder}: holds no twin.toml; give the folder that `qcar-twin diagnose --out` wrote")
  files = {
    "before": config.before or (folder and folder / "recalibrated.toml"),
    "after": config.after or (folder and folder / "twin.toml"),
  }
  return {name: load_twin(path, threads=1) for name, path in files.items() if path}


def fitted_shift(config: Config) -> int:
  """The timing that was fitted with a twin, where the calibration next to it says so."""
  for twin in (config.after, config.before):
    document = twin.with_name("calibration.json") if twin else None
    if document and document.is_file():
      return int(json.loads(document.read_text(encoding="utf-8")).get("command_shift", 0))
  return 0


if __name__ == "__main__":
  run_script()
