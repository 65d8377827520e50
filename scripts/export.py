"""Write a twin for another tool with what was lost measured, or recordings as MCAP.

Targets: mcap (recordings, twins and errors for Foxglove, PlotJuggler, Rerun), mjcf, single-track (NumPy and CasADi),
f1tenth, commonroad, vesc, robot-localization.

qcar-twin export --dataset data/sample --diagnosis out/diagnosed --out out/mcap

qcar-twin export --to single-track --twin out/diagnosed/twin.toml --dataset data/sample --out out/single_track.py
"""

import dataclasses
from pathlib import Path

from calibration.cross_validation.mcap_export import fitted_shift, loaded, of_dataset, of_log, twin_files
from calibration.exports.export import export_twin, is_a_file, refuse_idle
from calibration.exports.target import Job, target_named
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.file import load_twin


@dataclasses.dataclass(frozen=True)
class Config:
  """A twin and a target, or recordings and the twins to compare them with."""

  out: Path
  """The file, or a folder for it; of mcap the folder for one file per recording. Files of that name are replaced."""
  dataset: Path | None = None
  """Folder with dataset.toml, in SI units. With it numbers are matched to the twin, and the loss is measured."""
  recordings: tuple[str, ...] = ()
  """Names of recordings, for mcap; all of them where not given."""
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
  to: str = "mcap"
  """Target: mcap, mjcf, single-track, f1tenth, commonroad, vesc, robot-localization."""
  twin: Path | None = None
  """Twin file to export; of targets other than mcap."""
  pole_pairs: int | None = None
  """Of the motor; for vesc."""
  vesc: Path | None = None
  """The vesc.yaml that the car drove with; for vesc, which corrects it."""


def OUT_IS_FILE(config: Config) -> bool:
  """Whether --out is the file, and no folder for files."""
  return config.to != "mcap" and is_a_file(config.out)


def main(config: Config) -> list[Path]:
  """Write the files and print their names; returns them."""
  refuse_idle(config.to, [f.name for f in dataclasses.fields(Config) if getattr(config, f.name) != f.default])
  if config.to != "mcap":
    return [of_twin(config)]
  if (config.dataset is None) == (config.log is None):
    raise ValueError("give either --dataset, a folder with dataset.toml, or --log, one file")
  if config.log:
    made = [of_log(config.log, config.out)]
  else:
    assert config.dataset is not None
    if config.window < 0.0:
      raise ValueError(f"--window {config.window:g}: give 0 s, for one free run, or more")
    files = twin_files(config.diagnosis, config.before, config.after)
    shift = fitted_shift(files.get("after"), files.get("before"))
    shift = shift if config.command_shift is None else config.command_shift
    data = DataSet.load(config.dataset)
    made = of_dataset(data, config.recordings, loaded(files), config.window, shift, config.out)
  for path in made:
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")
  return made


def of_twin(config: Config) -> Path:
  """One file of another target than mcap."""
  target_named(config.to)
  if config.twin is None:
    raise ValueError(f"an export to {config.to} needs --twin, a file that calibrate or diagnose wrote")
  twin, theta = load_twin(config.twin, threads=1)
  dataset = DataSet.load(config.dataset) if config.dataset else None
  shift = fitted_shift(config.twin) if config.command_shift is None else config.command_shift
  options = {"pole_pairs": str(config.pole_pairs or ""), "vesc": str(config.vesc or "")}
  return export_twin(config.to, Job(twin, theta, dataset, shift, options), config.out)[0]


if __name__ == "__main__":
  run_script()
