"""Recalibrate on sessions without an effect: parameters against truth, and poor starts.

qcar-twin benchmark-base --out docs/results/base.md
"""

import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np

from calibration.concealed.benchmarks.base import INSIDE, LAGS, ONE, base_row, by_parameter, recalibrated_base
from calibration.concealed.benchmarks.disturbances import disturbance_table
from calibration.concealed.benchmarks.known import CARS
from calibration.concealed.benchmarks.under_way import under_way_cases, under_way_table
from calibration.concealed.campaign.intervals import exact_interval
from calibration.progress import counted
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Sessions of the independent car without any concealed effect."""

  out: Path = Path("docs/results/base.md")
  """Markdown page to write."""
  seed: int = 1
  """Seed of the first session of either car; the others follow it."""
  sessions: int = 10
  """Number of sessions of either independent car."""
  cars: tuple[Literal["first", "second"], ...] = ("first", "second")
  """Independent cars, whose figures their generators state."""
  poor: int = 4
  """Number of further starts for each car, with other tyres and another motor."""
  under_way: int = 0
  """In place of these: so many sessions of either independent car whose recordings begin while it drives."""
  disturbances: int = 0
  """In place of these: so many sessions of either, against the same cars without floor and draught."""
  quick: bool = False
  """One car and one poor start."""


def main(config: Config) -> str:
  """Run it and write the page."""
  if config.under_way:
    return kept(config, under_way_table(under_way_cases(config.seed, 1 if config.quick else config.under_way)))
  if config.disturbances:
    return kept(config, disturbance_table(config.seed, 1 if config.quick else config.disturbances))
  sessions, poor = (1, 1) if config.quick else (config.sessions, config.poor)
  cars = [(car, config.seed + k) for k in range(sessions) for car in config.cars[: 1 if config.quick else None]]
  bases = (recalibrated_base(car, CARS[car](seed), poor) for car, seed in cars)
  fits = list(counted(bases, len(cars), "session"))
  scores = [z for one in fits for z in one.score.values()]
  titles = (
    "car, seed",
    "error [%] (in standard deviations)",
    "within 90 %",
    "poor starts in the least minimum",
    "their costs over the usual start's [nats]",
    f"largest correlation at lags {LAGS[0]} to {LAGS[-1]}",
  )
  inside = sum(abs(z) <= INSIDE for z in scores)
  ends = f"{sum(one.in_one for one in fits)} of {len(fits) * poor}"
  whole = f"{sum(one.in_one == poor for one in fits)} of {len(fits)}"
  who = " ".join(dict(cars))
  low, high = exact_interval(inside, len(scores))
  lines = [
    "# Recalibration on sessions without an effect",
    "",
    f"`qcar-twin benchmark-base --seed {config.seed} --sessions {sessions} --poor {poor} --cars {who}`: sessions of",
    "independent cars, design `compact`, calibrated as a diagnosis recalibrates. Poor starts have 0.6 or 1.6 times the",
    f"stiffness of the tyres and the gain of the motor; a minimum is the same up to {ONE:g} nats.",
    "",
    f"* {inside} of {len(scores)} parameters lie in their 90 % interval (95 % interval of that share: {low:.0%} to",
    f"  {high:.0%}); errors are {np.sqrt(np.mean(np.square(scores))):.1f} times what is stated, root mean square.",
    f"* Errors are {np.std([z for one in fits for z in one.alone.values()]):.1f} times the deviations of the fit alone,"
    " root mean square about their mean.",
    *(f"* {line}" for line in by_parameter(fits)),
    *([f"* {ends} poor starts end in the least minimum; all of a", f"  session's in {whole}."] if poor else []),
    "",
    *markdown.table(titles, [base_row(*car, fit) for car, fit in zip(cars, fits, strict=True)]),
  ]
  return kept(config, "\n".join(lines) + "\n")


def kept(config: Config, text: str) -> str:
  """A page, written and printed."""
  write_text(config.out, text)
  print(text)
  return text


if __name__ == "__main__":
  run_script()
