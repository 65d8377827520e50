"""Measure how long QCar scripts take on every car, and whether two drives are the same.

qcar-twin benchmark-onboard --out out/onboard.md
"""

import dataclasses
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from calibration.concealed.proving_ground.onboard import independent_car
from calibration.progress import counted
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.onboard.drive import Terms, drive
from qcar_twin.onboard.plants import OnboardPlant, twin_plant
from qcar_twin.onboard.recorder import recording_of
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.file import load_twin
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

OUT_IS_FILE = True
_MINUTE = 60.0  # s of driving that times are stated for


@dataclasses.dataclass(frozen=True)
class Config:
  """Scripts without arguments."""

  out: Path = Path("out/onboard.md")
  """Markdown page to write."""
  scripts: Path = Path("tests/qcar_twin/onboard/scripts")
  """Folder of the scripts; each .py file is one."""
  twin: Path | None = None
  """File twin.toml of a calibration or a diagnosis; the nominal QCar where not given."""
  car: int | None = None
  """Seed of an independent car that is driven, too; it takes ten times as long."""
  seconds: float = 600.0
  """Simulated time after which a script is stopped as by Ctrl-C, s."""
  quick: bool = False
  """The reduced car alone, stopped after 3 s."""


def plants(config: Config) -> dict[str, Callable[[], OnboardPlant]]:
  """Functions that make the cars to drive, by the car's name."""
  nominal = Twin(Vehicle.load(), threads=1)
  twin = load_twin(config.twin, threads=1) if config.twin else (nominal, nominal.parameters.nominal)
  made = {"reduced car": lambda: twin_plant(*twin, "reduced")}
  if not config.quick:
    made["twin"] = lambda: twin_plant(*twin, "mujoco")
  if config.car is not None and not config.quick:
    made[f"independent car {config.car}"] = partial(independent_car, config.car, (), 0)
  return made


def driven(script: Path, plant: OnboardPlant, seconds: float) -> tuple[Recording, float, float, float]:
  """The recording of a drive, what was driven, wall time and processor time, s. Raises RuntimeError where it fails."""
  began = time.process_time()
  made = drive(script, plant, Terms(seconds=seconds))
  if made.error:
    raise RuntimeError(f"{script}: {made.error}")
  return recording_of(made.car, script.stem), made.seconds, made.wall, time.process_time() - began


def same(one: Recording, other: Recording) -> bool:
  """Whether two recordings are equal to the bit."""
  pairs = [(one[c], other[c]) for c in one.channels] if one.channels == other.channels else []
  return bool(pairs) and all(
    np.array_equal(a.time, b.time) and np.array_equal(a.value, b.value, equal_nan=True) for a, b in pairs
  )


def main(config: Config) -> str:
  """Drive every script twice on every car and write the page."""
  seconds = 3.0 if config.quick else config.seconds
  made, scripts = plants(config), sorted(config.scripts.glob("*.py"))
  if not scripts:
    raise FileNotFoundError(f"{config.scripts}: holds no script; name a folder of .py files with --scripts")
  rows = []
  for name, script in counted([(n, s) for n in made for s in scripts], len(made) * len(scripts), "script"):
    (one, length, *first), (other, _, *second) = (driven(script, made[name](), seconds) for _ in range(2))
    wall, spent = (_MINUTE / length * min(pair) for pair in zip(first, second, strict=True))
    rows.append(
      (name, script.stem, f"{length:.0f}", f"{wall:.1f}", f"{spent:.1f}", "yes" if same(one, other) else "no")
    )
  titles = ("car", "script", "driven, s", "wall for 60 s, s", "processor for 60 s, s", "twice the same to the bit")
  text = "\n".join([*markdown.table(titles, rows), ""])
  write_text(config.out, text)
  print(text)
  return text


if __name__ == "__main__":
  run_script()
