"""Measure who is accused in fleets of equal cars and in fleets with an odd one.

A driven fleet's logs and their calibrations stay in --work; the same command goes on with the rest.

qcar-twin benchmark-fleet --fleets 200 --driven 2 --out out/fleet.md
"""

import dataclasses
from pathlib import Path

from calibration.concealed.benchmarks import fleet as benchmark
from calibration.concealed.benchmarks.fleet import KINDS, LOSS, Judged, Scanned, drawn_fleet, judged, scanned, shares
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

OUT_IS_FILE = True
KEPT = "logs that were driven and calibrated stay in --work, the same command goes on with the rest"


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
  """Fleets of equal cars that the independent car drives, each again with one car odd."""
  logs: int = 1
  """Logs of each car of a driven fleet, about two minutes of driving each."""
  scanned: int = 0
  """Files on disk that a scan is timed on, copies of those of --sample under other names."""
  sample: Path = Path("data/sample")
  """Data set whose CSV files are copied."""
  quick: bool = False
  """Ten fleets of each kind, none driven, 35 files at most."""


def _place(fleet: Judged) -> str:
  return f"{fleet.place} of {fleet.of}, chance {fleet.chance:.1e}"


def _scan(one: Scanned) -> str:
  took = f"{one.wall:.0f} s, {one.processor:.0f} s of processor time"
  return f"A scan of {one.logs} logs, {one.driven / 60.0:.0f} min of driving, {one.refused} refused: {took}.\n"


def main(config: Config) -> str:
  """Draw, drive what is missing, and write the page."""
  fleets = 10 if config.quick else config.fleets
  rows = []
  for kind, how in KINDS.items():
    made = [judged(drawn_fleet(1000 * config.seed + k, **how)) for k in range(fleets)]
    anyone, spotted, named, alone = shares(made)
    rows.append((kind, anyone, *((spotted, named, alone) if "odd" in how else ("", "", ""))))
  titles = ("fleets of estimates", "accuse anyone", "accuse the odd car", "of what is odd", "and of nothing else")
  text = "\n".join([*markdown.table(titles, rows), ""])
  if config.driven and not config.quick:
    fleets_driven = list(benchmark.driven_fleets(config.work, config.seed, config.driven, config.logs))
    anyone = shares([f for _, odd, f in fleets_driven if not odd])[0]
    _, *spotted = shares([f for _, odd, f in fleets_driven if odd])
    rows = [("equal cars", anyone, "", "", ""), (f"one car with {100.0 * LOSS:.0f} % less grip", "", *spotted)]
    text += "\n" + "\n".join([*markdown.table(("driven fleets", *titles[1:]), rows), ""])
    rows = [
      (name, ", ".join(f"{unit}: {what}" for unit, what in f.accused) or "nobody", f.first, _place(f) if odd else "")
      for name, odd, f in fleets_driven
    ]
    titles = ("driven fleet", "accused", "least likely of all", "the odd car's grip among all comparisons")
    text += "\n" + "\n".join([*markdown.table(titles, rows), ""])
  if config.scanned:
    text += "\n" + _scan(scanned(config.sample, min(config.scanned, 35) if config.quick else config.scanned))
  write_text(config.out, text)
  print(text)
  return text


if __name__ == "__main__":
  run_script()
