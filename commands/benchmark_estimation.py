"""Measure the filter and the controllers and write their page with its figures.

qcar-twin benchmark-estimation --dart ../shared/data/dart
"""

import dataclasses
from pathlib import Path

from agents.control.controllers import load
from agents.control.model import Model
from agents.studies.estimation_report import cost_section, oval_section, recorded_section
from agents.studies.tracking_report import tracking_section
from calibration.identification.identification import identify
from qcar_twin.atomic_io import write_text
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.vehicle.vehicle import Vehicle

HEAD = """# Results: sensors, federated filter, model-based controllers

Made by `qcar-twin benchmark-estimation{options}`; every number below is measured by it, none is typed in.
Medians, interquartile ranges in brackets.
"""


@dataclasses.dataclass(frozen=True)
class Config:
  """What is measured."""

  out: Path = Path("docs/results_estimation.md")
  """Markdown file; figures go into a folder of its name beside it"""
  dart: Path | None = None
  """the dart data set; its section is left out without it"""
  seeds: int = 20
  """cars with sensor noise of their own on the oval"""
  runs: int = 8
  """cars per case of the controller table"""
  quick: bool = False
  """two cars, one lap, few cases"""


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
  count, runs = (2, 2) if config.quick else (config.seeds, config.runs)
  options = (f" --dart {config.dart}" if config.dart else "") + " --quick" * config.quick
  sections = [
    HEAD.format(options=options).splitlines(),
    oval_section(model, controllers["lq_cm", "tuned"], count, figures, quick=config.quick),
    recorded(config, figures),
    tracking_section(model, controllers, runs, figures, quick=config.quick),
    cost_section(model),
  ]
  write_text(config.out, "\n\n".join("\n".join(section) for section in sections) + "\n")
  print(f"wrote {config.out}")
