"""Measure what the online filter gets through on three cars, and write its page.

qcar-twin benchmark-filter [--out docs/results/filter.md] [--quick]
"""

import dataclasses
from pathlib import Path

import numpy as np

from agents.control.model import Model
from agents.studies.filtering.acceptance_report import acceptance_sections, limit_section
from agents.studies.filtering.acceptance_study import Subject
from calibration.concealed.laboratory.written import stream
from calibration.concealed.proving_ground.plant import ProvingGroundPlant
from calibration.concealed.proving_ground.session import Spec
from calibration.concealed.proving_ground.session import drawn_car as first_car
from calibration.concealed.second_car.plant import SecondCarPlant
from calibration.concealed.second_car.session import drawn_car as second_car
from qcar_twin.atomic_io import write_text
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.command_line import run_script
from qcar_twin.recordings.recording import nearest
from qcar_twin.vehicle.vehicle import Vehicle

LONGEST = 20.0  # s, of a drive
HEAD = """# Results: what the filter gets through

Made by `qcar-twin benchmark-filter{options}`; every number below is measured by it, none is typed in.
"""

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Cars and cases."""

  out: Path = Path("docs/results/filter.md")
  """Markdown file."""
  cars: tuple[str, ...] = ("twin", "first", "second")
  """The twin on the reduced plant, the first and the second independent car."""
  seed: int = 3
  """Which independent cars are drawn."""
  more: int = 4
  """How many further cars of each independent kind are driven at the limit; drawn by the seeds after `seed`."""
  quick: bool = False
  """Few cases."""


def subject(name: str, seed: int) -> Subject:
  """A car by name, with what its filter is told: of the independent cars the vehicle table as measured."""
  if name == "twin":
    model = Model.nominal()
    twin, theta = model.plant("reduced")
    begin = lambda start: twin.begin(np.tile(theta, (len(start), 1)), start)
    return Subject(name, begin, model.car, model.filter_settings("reduced"))
  if name == "first":
    car = first_car(Spec(seed))
    plant = ProvingGroundPlant(car, noise=1.0, seed=seed)
  elif name == "second":
    car = second_car(seed)
    plant = SecondCarPlant(car, noise=1.0, seed=seed, seconds=LONGEST)
  else:
    raise ValueError(f"no car '{name}'{nearest(name, Config.cars)}")
  vehicle = Vehicle.from_dataset(*car.measured(stream(seed, 1)))
  told = Model(vehicle, Bicycle(vehicle).parameters.nominal)
  return Subject(name, plant.begin, told.car, told.filter_settings("reduced"))


def main(config: Config) -> None:
  """Measure everything and write the page."""
  subjects = [subject(name, config.seed) for name in config.cars]
  options = "".join(
    f" --{name} {getattr(config, name)}" for name in ("seed", "more") if getattr(config, name) != getattr(Config, name)
  )
  options += " --quick" * config.quick
  lines = acceptance_sections(subjects, quick=config.quick)
  kinds = [name for name in config.cars if name != "twin"]
  more = [subject(name, config.seed + 1 + i) for name in kinds for i in range(1 if config.quick else config.more)]
  section = "\n".join([*lines, "", *limit_section(more)] if more else lines)
  write_text(config.out, f"{HEAD.format(options=options)}\n{section}\n")
  print(f"wrote {config.out}")


if __name__ == "__main__":
  run_script()
