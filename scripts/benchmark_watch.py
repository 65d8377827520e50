"""Watch independent cars for hours without a change, and through changes; write a page.

qcar-twin benchmark-watch --car first --sessions 120 --out out/watch_first.md
"""

import dataclasses
from pathlib import Path

from calibration.concealed.benchmarks.watch import CHANGES, Which, nulls, seen, watch_of
from calibration.progress import StageLine
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Sessions of one car of a generator that shares no code with the twin."""

  out: Path = Path("out/watch.md")
  """Markdown page to write."""
  car: Which = "first"
  """Independent car; changes are those of the first alone."""
  seed: int = 5
  """Of the car, of its session that the twin is calibrated on, and of all others."""
  sessions: int = 120
  """Sessions without a change, 5 min of driving each on the first car and 2 min on the second."""
  trials: int = 10
  """Random orders in which each change is driven."""
  quick: bool = False
  """One session and one order."""


def main(config: Config) -> str:
  """Run it and write the page."""
  watch = watch_of(config.car, config.seed)
  with StageLine() as progress:
    driven, alarms = nulls(watch, config.car, config.seed, 1 if config.quick else config.sessions, progress)
  text = f"Without a change: {len(alarms)} alarms in {driven / 3600.0:.2f} h of driving.\n"
  text += "".join(f"\n* {alarm.sentence}" for alarm in alarms)
  trials = 1 if config.quick else config.trials
  rows = []
  for change in CHANGES if config.car == "first" else ():
    for one in seen(watch, change, config.seed, trials):
      rows.append((one.change, f"{one.shown:.0f}", f"{one.driven:.0f}", one.name or "nothing", f"{one.size:.3g}"))
  if rows:
    titles = ("change", "driving that shows it, s", "all driving, s", "named", "size")
    text += "\n".join(["", *markdown.table(titles, rows), ""])
  write_text(config.out, text)
  print(text)
  return text


if __name__ == "__main__":
  run_script()
