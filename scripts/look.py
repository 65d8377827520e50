"""Look at a log before anything is known about it: traces, map, a verdict of each channel.

Needs no dataset.toml: what `new` would guess is used, and nothing is written but the page and its numbers, check.json.

qcar-twin look drive_1.csv --out out/look
"""

import dataclasses
import tempfile
from pathlib import Path
from typing import Annotated

import tyro

from calibration.log_check.check import LogCheck
from calibration.log_check.report import check_and_say, write_raw
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.recordings.first_dataset.parts.drives import drives_of
from qcar_twin.recordings.first_dataset.place import logs_of, placed
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.manifest import FILE_NAME
from qcar_twin.recordings.recording import RecordingError


@dataclasses.dataclass(frozen=True)
class Config:
  """Logs, or a data set; what cannot be read as a drive is shown column by column, with the reason."""

  logs: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="LOGS")]]
  """Log files, bags or folders of them, or one folder with a dataset.toml."""
  out: Path = Path("out/look")
  """Folder for the page."""


def main(config: Config) -> LogCheck | None:
  """Write the page, print the verdict and what it is about; None where the log could not be read as a drive."""
  if not config.logs:
    raise ValueError("give LOGS: log files, bags or folders of them, or one folder with a dataset.toml")
  if len(config.logs) == 1 and (config.logs[0] / FILE_NAME).is_file():
    return check_and_say(config.logs[0], config.out)
  with tempfile.TemporaryDirectory() as folder:
    place = Path(folder) / (config.logs[0].resolve().stem or "log")
    drives = drives_of(place, placed(place, logs_of(config.logs)))
    proposal = propose(place.name, drives.tables)
    print("".join(f"{line}\n" for line in drives.said), end="")
    drives.lay(place)
    write_text(place / FILE_NAME, proposal.text)
    print("\n".join(f"  {line}" for line in proposal.channels))
    try:
      return check_and_say(place, config.out)
    except RecordingError as error:
      page = write_raw(drives.tables, str(error), proposal.channels, config.out)
      print(f"Not readable as a drive yet: {error}\npage: {page}")
      return None


if __name__ == "__main__":
  run_script()
