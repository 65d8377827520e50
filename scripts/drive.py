"""Run a QCar script unchanged on the twin, on simulated time, and record what was driven.

qcar-twin drive my_script.py --twin out/sample/diagnosis/twin.toml --effect steering_delay=0.04 -- 1 20
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from calibration.concealed.proving_ground.onboard import independent_car
from qcar_twin.command_line import run_script
from qcar_twin.onboard.drive import Drive, Terms, drive
from qcar_twin.onboard.likeness import compared, drives_of_script
from qcar_twin.onboard.plants import OnboardPlant, twin_plant, with_effects
from qcar_twin.onboard.recorder import add_drive, free_name, recording_of
from qcar_twin.twin.file import load_twin
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle


class ScriptFailed(RuntimeError):
  """A script that did not come to its end; the text is its own traceback, and where what was driven is kept."""


POSITIVE = ("seconds",)


@dataclasses.dataclass(frozen=True)
class Config:
  """The script, the car under it, and where the recording goes."""

  script: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="SCRIPT")]]
  """Python file that drives a QCar; its own arguments follow after --."""
  arguments: tyro.conf.Positional[Annotated[tuple[str, ...], tyro.conf.arg(metavar="ARGUMENTS")]] = ()
  """Arguments of the script."""
  twin: Path | None = None
  """File twin.toml of a calibration or a diagnosis; the nominal QCar where not given."""
  plant: Literal["mujoco", "reduced", "proving_ground"] = "mujoco"
  """What is driven: the twin in MuJoCo, the twin on the reduced car, or the independent car that stands in for a real
  one."""
  effect: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
  """NAME=VALUE, repeatable: a parameter in its unit; of the independent car, an effect in typical sizes."""
  record: Path | None = None
  """Folder of a data set that the drive is added to; made where it is not there."""
  compare: Path | None = None
  """Data set, such as the car's own, whose recordings of the same script this drive is compared to."""
  real_time: bool = False
  """Let a simulated second take a second, for a human who watches."""
  seconds: float = 600.0
  """Simulated time after which the script is stopped as by Ctrl-C, s."""
  patience: float = 30.0
  """Wall time that the script may compute without looking at a clock or at the car, s."""
  seed: int = 0
  """Seed of the sensors' noise and of the shared random numbers."""
  car: int = 0
  """Seed of the independent car that is driven."""
  answer: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
  """Answer to the script's calls of input(), repeatable, in order."""
  library: Path | None = None
  """Folder with your own copy of the car's Python library, for modules that are not offered here."""


def plant_of(config: Config) -> OnboardPlant:
  """What is driven."""
  if config.plant == "proving_ground":
    if config.twin:
      raise ValueError("the independent car is no twin: leave --twin out, or choose --plant mujoco")
    return independent_car(config.car, config.effect, config.seed)
  nominal = Twin(Vehicle.load(), threads=1)
  twin, theta = load_twin(config.twin, threads=1) if config.twin else (nominal, nominal.parameters.nominal)
  return twin_plant(*with_effects(twin, theta, config.effect), config.plant)


def main(config: Config) -> Drive:
  """Drive, record, print what was driven; what ended a script early is raised when its recording is kept."""
  plant, script = plant_of(config), config.script.stem
  theirs = drives_of_script(config.compare, script) if config.compare else {}
  name, shared = free_name(config.record, script, plant), {f.name for f in dataclasses.fields(Terms)} - {"name"}
  driven = drive(config.script, plant, Terms(name=name, **{key: getattr(config, key) for key in shared}))
  print(f"drove {driven.seconds:.1f} s in {driven.wall:.1f} s: {plant.name}")
  for note in driven.notes:
    print(f"note: {note}")
  kept = "nothing is kept without --record"
  if config.record:
    added = add_drive(config.record, recording_of(driven.car, name), plant, config.script.name)
    kept = f"{config.record}: " + ", ".join(f"{r.name} ({r.role})" for r in added)
    print(kept)
  if config.compare:
    print(compared(recording_of(driven.car, name), config.compare, theirs))
  if driven.error:
    raise ScriptFailed(f"{driven.error}\n{config.script.name} ended early after {driven.seconds:.1f} s; {kept}")
  return driven


if __name__ == "__main__":
  run_script()
