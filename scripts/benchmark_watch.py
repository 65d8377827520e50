"""Watch independent cars for hours without a change, and through changes; write a page.

What was watched stays next to the page, as NDJSON; the same command goes on with the rest.

qcar-twin benchmark-watch --car first --sessions 100 --out out/watch_first.md
"""

import dataclasses
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from calibration.concealed.benchmarks.kept import Part, kept
from calibration.concealed.benchmarks.watch import CHANGES, Which, mark_of, quiet, seen, share_of_a_core, watch_of
from calibration.concealed.campaign.intervals import exact_rate
from calibration.watch.watch import Watch
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

AT_ONCE = 10  # sessions that are watched on end, and driven side by side
OUT_IS_FILE = True
KEPT = "what was watched stays next to the page, the same command goes on with the rest"
_RATE = 10.0  # h, in which alarms are counted


@dataclasses.dataclass(frozen=True)
class Config:
  """Sessions of one car of a generator that shares no code with the twin."""

  out: Path = Path("out/watch.md")
  """Markdown page to write."""
  car: Which = "first"
  """Independent car."""
  seed: int = 5
  """Of the car, of its session that the twin is calibrated on, and of all others."""
  sessions: int = 100
  """Sessions without a change, 5 min of driving each on the first car and 2 min on the second."""
  trials: int = 10
  """Random orders in which each change is driven."""
  quick: bool = False
  """One session and one order."""


def parts(config: Config, watch: Watch) -> Iterator[Part]:
  """What is watched on end: driving without a change, each change, one log as it grows."""
  sessions, trials = (1, 1) if config.quick else (config.sessions, config.trials)
  car, seed = config.car, config.seed
  key = {"car": car, "seed": seed, "twin": mark_of(watch)}
  for first in range(0, sessions, AT_ONCE):
    some = min(AT_ONCE, sessions - first)
    yield key | {"first": first, "sessions": some}, partial(_quiet, watch, car, seed, first, some)
  for change in CHANGES if trials else ():
    yield key | {"change": change, "trials": trials}, partial(_seen, watch, car, change, seed, trials)
  yield key | {"share": "of a core"}, lambda: {"of_a_core": share_of_a_core(watch, car, seed)}


def _quiet(*what: Any) -> dict[str, Any]:
  return dataclasses.asdict(quiet(*what))


def _seen(*what: Any) -> dict[str, Any]:
  return {"seen": [dataclasses.asdict(one) for one in seen(*what)]}


def page(config: Config, lines: list[dict[str, Any]]) -> str:
  """Hours and alarms, how each change was seen, share of a core."""
  hours = sum(line["driven"] for line in lines if "driven" in line) / 3600.0
  alarms = [alarm for line in lines for alarm in line.get("alarms", ())]
  low, high = exact_rate(len(alarms), hours / _RATE)
  text = f"The {config.car} car without a change, {AT_ONCE} sessions on end: {len(alarms)} alarms in {hours:.2f} h of"
  text += f" driving; 95 % interval {low:.2g} to {high:.2g} in {_RATE:g} h.\n"
  text += "".join(f"\n* {alarm}" for alarm in alarms)
  rows = [
    (one["change"], f"{one['shown']:.0f}", f"{one['driven']:.0f}", one["name"] or "nothing", _number(one["size"]))
    for line in lines
    for one in line.get("seen", ())
  ]
  if rows:
    titles = ("change", "driving that shows it, s", "all driving, s", "named", "size")
    text += "\n".join(["", *markdown.table(titles, rows), ""])
  (share,) = (line["of_a_core"] for line in lines if "of_a_core" in line)
  return text + f"\nShare of a core at 100 Hz, MCAP at the end included: {100.0 * share:.1f} %.\n"


def _number(value: float | None) -> str:
  return "" if value is None else f"{value:.3g}"


def main(config: Config) -> str:
  """Watch what is missing and write the page."""
  watch = watch_of(config.car, config.seed)
  text = page(config, kept(config.out.with_suffix(".ndjson"), list(parts(config, watch))))
  write_text(config.out, text)
  print(text)
  return text


if __name__ == "__main__":
  run_script()
