"""Measure the filter and the controllers, and write their page with its figures.

qcar-twin benchmark-estimation --dart ../shared/data/dart [--sections faults cost]
"""

import dataclasses
import re
from pathlib import Path

from agents.control.controllers import load
from agents.control.model import Model
from agents.studies.estimation_report import cost_section, oval_section, recorded_section
from agents.studies.fault_report import fault_section
from agents.studies.filtering.mismatch_report import mismatch_section, noise_section, states_section
from agents.studies.tracking_report import tracking_section
from calibration.identification.identification import identify
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.vehicle.vehicle import Vehicle

TITLES = "## Oval|## Nominal|## Other|## What|## Real|## The filter under faults|## Controllers|## Cost".split("|")
SECTIONS = ("oval", "mismatch", "noise", "states", "recorded", "faults", "tracking", "cost")
HEAD = """# Results: sensors, federated filter, model-based controllers

Made by `qcar-twin benchmark-estimation{options}`; every number below is measured by it, none is typed in.
Medians, interquartile ranges in brackets.
"""

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Sections of the page, and how much is driven for each."""

  out: Path = Path("docs/results/estimation.md")
  """Markdown file; figures go into a folder of its name next to it."""
  dart: Path | None = None
  """Folder of the dart data set; its section is left out where not given."""
  seeds: int = 20
  """Number of cars on the oval, each with sensor noise of its own."""
  runs: int = 8
  """Number of cars per case of the controller table."""
  faulty: int = 8
  """Number of cars per path and class of faults."""
  bent: int = 8
  """Number of cars per path and linkage of the sections mismatch, noise and states."""
  sections: tuple[str, ...] = SECTIONS
  """Sections to measure: oval, mismatch, noise, states, recorded, faults, tracking, cost. The others stay."""
  quick: bool = False
  """Two cars, one lap, few cases."""


def recorded(config: Config, figures: Path) -> list[str]:
  """The section on real data, empty without the data set."""
  if config.dart is None or not config.dart.is_dir():
    return ["## Real recordings (dart)", "", "Left out: run with `--dart DIR`."]
  dataset = DataSet.load(config.dart)
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  bicycle, theta = identify(dataset, vehicle=vehicle).bicycle(vehicle)
  return recorded_section(dataset, vehicle, bicycle.car(theta), figures, quick=config.quick)


def main(config: Config) -> None:
  """Measure everything and write the page."""
  figures = config.out.with_suffix("")
  figures.mkdir(parents=True, exist_ok=True)
  model = Model.nominal()
  controllers = load(model.car)
  count, runs, faulty, bent = (2,) * 4 if config.quick else (config.seeds, config.runs, config.faulty, config.bent)
  options = (f" --dart {config.dart}" if config.dart else "") + " --quick" * config.quick
  best = controllers["lq_cm", "tuned"]
  work = {
    "oval": lambda: oval_section(model, best, count, figures, quick=config.quick),
    "mismatch": lambda: mismatch_section(model, best, bent, quick=config.quick),
    "noise": lambda: noise_section(model, best, bent, quick=config.quick),
    "states": lambda: states_section(model, best, bent, quick=config.quick),
    "recorded": lambda: recorded(config, figures),
    "faults": lambda: fault_section(model, best, faulty, quick=config.quick),
    "tracking": lambda: tracking_section(model, controllers, runs, figures, quick=config.quick),
    "cost": lambda: cost_section(model, quick=config.quick),
  }
  kept = pieces(config.out)
  if unknown := set(config.sections) - set(work):
    raise ValueError(f"no section {', '.join(sorted(unknown))}; there are {', '.join(SECTIONS)}")
  for name, make in work.items():
    if name in config.sections:
      text = "\n".join(make())
      kept[text.splitlines()[0]] = text
      print(f"{name}: measured")
  order = [title for start in TITLES for title in kept if title.startswith(start)]
  write_text(config.out, "\n\n".join([HEAD.format(options=options).rstrip("\n"), *(kept[t] for t in order)]) + "\n")
  print(f"wrote {config.out}")


def pieces(page: Path) -> dict[str, str]:
  """Sections of a page that was written before, by title."""
  text = page.read_text(encoding="utf-8") if page.is_file() else ""
  sections = [piece.strip() for piece in re.split(r"^(?=## )", text, flags=re.MULTILINE)[1:]]
  return {piece.splitlines()[0]: piece for piece in sections}


if __name__ == "__main__":
  run_script()
