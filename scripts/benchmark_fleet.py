"""Who is odd in fleets of equal cars and in fleets with an odd one: of estimates, and driven end to end; write a page.

A driven fleet's logs and their calibrations stay in --work; the same command goes on with the rest.

qcar-twin benchmark-fleet --fleets 200 --driven 2 --out out/fleet.md
"""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

from calibration.concealed.benchmarks.fleet import CARS, LOSS, Judged, drawn_fleet, drive_log, judged, judged_drives
from calibration.concealed.campaign.intervals import exact_interval
from calibration.progress import counted
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

OUT_IS_FILE = True
KEPT = "logs that were driven and calibrated stay in --work, the same command goes on with the rest"
KINDS = {
  "equal cars": {},
  "equal, stated deviations 1.5 times too small": {"understated": 1.5},
  "equal but for a scatter between cars of one stated deviation": {"scatter": 1.0},
  "the same, of two": {"scatter": 2.0},
  f"one car {100 * LOSS:.0f} % off in a parameter known to 4 %": {"odd": LOSS},
}  # what is drawn, and how


@dataclasses.dataclass(frozen=True)
class Config:
  """Fleets of six cars."""

  out: Path = Path("out/fleet.md")
  """Markdown page to write."""
  work: Path = Path("out/fleets")
  """Folder of the driven fleets; delete it to drive them again."""
  seed: int = 1
  """Of the first fleet; the others follow it."""
  fleets: int = 200
  """Fleets of each kind at the level of estimates."""
  driven: int = 0
  """Fleets of equal cars, and as many with an odd one, that the independent car drives."""
  logs: int = 1
  """Logs of each car of a driven fleet, about two minutes of driving each."""
  quick: bool = False
  """Ten fleets of each kind, none driven."""


def shares(fleets: Sequence[Judged]) -> list[str]:
  """Fleets that accuse anyone, find the odd car, name what is odd, and that alone; with exact 95 % intervals."""
  row = []
  for hits in (sum(getattr(f, name) for f in fleets) for name in ("anyone", "found", "named", "alone")):
    low, high = exact_interval(hits, len(fleets))
    row.append(f"{hits} of {len(fleets)} ({low:.3f} to {high:.3f})")
  return row


def driven(config: Config) -> Iterator[tuple[str, bool, Judged]]:
  """Every driven fleet with its name and whether a car is odd, equal ones and odd ones in turn."""
  named = [
    (f"{'odd' if odd else 'equal'}_{config.seed + k}", config.seed + k, odd)
    for k in range(config.driven)
    for odd in (False, True)
  ]
  places = [(*fleet, car, log) for fleet in named for car in range(CARS) for log in range(config.logs)]
  steps = (drive_log(config.work / name, seed, odd, car, log) for name, seed, odd, car, log in places)
  for _ in counted(steps, len(places), "log"):
    pass
  yield from ((name, odd, judged_drives(config.work / name)) for name, _, odd in named)


def _place(fleet: Judged) -> str:
  return f"{fleet.place} of {fleet.of}, chance {fleet.chance:.1e}"


def main(config: Config) -> str:
  """Draw, drive what is missing, and write the page."""
  fleets = 10 if config.quick else config.fleets
  rows = []
  for kind, how in KINDS.items():
    made = [judged(drawn_fleet(1000 * config.seed + k, **how)) for k in range(fleets)]
    anyone, found, named, alone = shares(made)
    rows.append((kind, anyone, *((found, named, alone) if "odd" in how else ("", "", ""))))
  titles = ("fleets of estimates", "accuse anyone", "accuse the odd car", "of what is odd", "and of nothing else")
  text = "\n".join([*markdown.table(titles, rows), ""])
  if config.driven and not config.quick:
    rows = [
      (name, ", ".join(f"{unit}: {what}" for unit, what in f.accused) or "nobody", f.first, _place(f) if odd else "")
      for name, odd, f in driven(config)
    ]
    titles = ("driven fleet", "accused", "least likely of all", "the odd car's grip among all comparisons")
    text += "\n" + "\n".join([*markdown.table(titles, rows), ""])
  write_text(config.out, text)
  print(text)
  return text


if __name__ == "__main__":
  run_script()
