"""Run the twin next to a car whose log is being written, and say when it no longer holds.

Measured, predicted and difference go into watch.ndjson in blocks of two seconds, and into watch.mcap at the end.
An alarm has evidence that is valid at any time (docs/guide/fleet.md).

qcar-twin watch --twin out/calibrated/twin.toml --dataset out/session --follow log.csv --out out/watch
"""

import dataclasses
import time
from pathlib import Path

from calibration.cross_validation.mcap_export import fitted_shift
from calibration.watch.evidence import BLOCK
from calibration.watch.follow import tail_of
from calibration.watch.record import Record, look
from calibration.watch.watch import Alarm, Watch
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.manifest import read_manifest
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.twin.file import load_twin

KEPT = "what was written into watch.ndjson until then is kept"

POSITIVE = ("every",)


@dataclasses.dataclass(frozen=True)
class Config:
  """A twin, the data set that it was calibrated on, and the log to follow."""

  follow: Path
  """CSV or MCAP file that is being appended to, its columns or topics as in the data set."""
  twin: Path
  """File twin.toml of a calibration or a diagnosis."""
  dataset: Path
  """Data set of the same car while the twin held: it says how the log is read and how the twin errs anyway."""
  out: Path = Path("out/watch")
  """Folder for watch.ndjson and watch.mcap; files of that name are replaced."""
  every: float = 0.5
  """Time between looks at the file, s."""
  patience: float = 10.0
  """Time without a new row after which the watch ends, s; 0 reads what is there and ends."""
  mcap: bool = True
  """Write watch.mcap at the end."""


def main(config: Config) -> list[Alarm]:
  """Follow the log, print alarms as they come; returns them. Raises RecordingError where nothing could be judged."""
  tail, manifest = tail_of(config.follow), read_manifest(config.dataset)
  data, (twin, theta) = DataSet.load(config.dataset), load_twin(config.twin, threads=1)
  watch = Watch(twin, theta, data.recordings, fitted_shift(config.twin))
  for said in watch.unwatched():
    print(said)
  alarms: list[Alarm] = []
  config.out.mkdir(parents=True, exist_ok=True)
  with (config.out / "watch.ndjson").open("w", encoding="utf-8") as file:
    record, began = Record(file, config.mcap), time.monotonic()
    last = began
    while True:
      before, said = tail.grew, set(record.notes)
      if tail.refused and time.monotonic() - began >= config.patience:
        record.notes.setdefault("refused", f"waiting, nothing can be judged yet: {tail.refused}")
      new = look(watch, tail, manifest, config.follow.stem, record)
      for text in (*(note for what, note in record.notes.items() if what not in said), *(a.sentence for a in new)):
        print(text, flush=True)
      alarms += new
      if tail.grew > before:
        last = time.monotonic()
      if time.monotonic() - last >= config.patience:
        break
      time.sleep(config.every)
  if tail.torn:
    print(f"{config.follow}: {tail.torn} rows have other cells than the names above them; left out")
  if not record.blocks:
    why = tail.refused or f"it holds less than {BLOCK:g} s of driving"
    raise RecordingError(f"{config.follow}: nothing could be judged; {why}")
  if config.mcap:
    print("\n".join(f"mcap: {file}" for file in record.mcap(config.out / "watch.mcap")))
  print(f"{record.blocks} blocks of {BLOCK:g} s, {len(alarms)} alarms: {config.out / 'watch.ndjson'}")
  return alarms


if __name__ == "__main__":
  run_script()
