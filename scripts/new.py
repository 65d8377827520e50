"""Write a first dataset.toml from logs, guesses marked with their reasons, and check it.

qcar-twin new my_session drive_1.csv drive_2.mcap

qcar-twin new my_session logs/
"""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from calibration.log_check.report import check_and_say
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.recordings.first_dataset.parts.drives import drives_of
from qcar_twin.recordings.first_dataset.place import logs_of, placed, without_header
from qcar_twin.recordings.first_dataset.propose import SAID, propose
from qcar_twin.recordings.manifest import FILE_NAME
from qcar_twin.recordings.recording import RecordingError


@dataclasses.dataclass(frozen=True)
class Config:
  """Channels are matched by name, unit and values, roles by file or time. No existing file is replaced."""

  folder: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FOLDER")]]
  """Folder of the data set; created where absent. It must not hold a dataset.toml."""
  files: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILES")]] = ()
  """Logs, or folders of logs; those outside FOLDER are copied into it. Without any, the logs in FOLDER are used."""
  wheelbase: float | None = None
  """Distance between the car's axles, m; without it that of a car that turns as the logs do."""
  mass: float | None = None
  """Mass of the car, kg; without it an estimate from the wheelbase."""
  wheel_radius: float | None = None
  """Radius of the wheels, m; without it an estimate from the wheelbase."""
  gear_ratio: float | None = None
  """Turns of a wheel per turn of the motor, 0.1 say; without it by the log's speeds, where both are there."""
  rate: float | None = None
  """Rate at which the rows of logs without a clock were written, Hz."""
  out: Path | None = None
  """Folder for the check's page; FOLDER_check next to the data set where not given."""


def main(config: Config) -> Path:
  """Write it, print every guess, and what the check finds; returns the path of dataset.toml."""
  drives = drives_of(config.folder, placed(config.folder, logs_of(config.files or (config.folder,), config.folder)))
  said = {key: figure for key in SAID if (figure := getattr(config, key)) is not None}
  proposal = propose(config.folder.resolve().name, drives.tables, config.rate, **said)
  print("".join(f"{line}\n" for line in drives.said), end="")
  for path in drives.lay(config.folder):
    print(f"  written: {path}")
  path = write_text(config.folder / FILE_NAME, proposal.text)
  logs = f"{len(drives.tables)} log{'s' if len(drives.tables) > 1 else ''}"
  print(f"{path}: {logs}, {len(proposal.guesses)} guesses to look at")
  print("\n".join(f"  {line}" for line in proposal.channels))
  print("".join(f"{line}\n" for line in without_header(drives.read)), end="")
  for name in proposal.missing:
    print(f"missing: {name}; no column seems to be it, fill it in in [channels]")
  if unsaid := [f"--{name.replace('_', '-')}" for name in SAID if name not in said]:
    print(f"not said: {', '.join(unsaid)}; the car's numbers in [vehicle] are estimates, correct them there")
  for question in proposal.questions:
    print(f"to be answered: {question}")
  page = config.out or config.folder.with_name(f"{config.folder.resolve().name}_check")
  try:
    check_and_say(config.folder, page)
  except RecordingError as error:
    raise RecordingError(f"{path} was written and is not yet readable: {error}") from error
  return path


if __name__ == "__main__":
  run_script()
