"""Scripts in a few lines, driven on a reduced car or on one that is worked out by hand."""

import functools
import textwrap
from pathlib import Path

import numpy as np

from qcar_twin.onboard.drive import Drive, Terms, drive
from qcar_twin.onboard.plants import OnboardPlant, twin_plant
from qcar_twin.plant import SIGNALS
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

SCRIPTS = Path(__file__).parent / "scripts"


@functools.cache
def reduced() -> OnboardPlant:
  """The nominal QCar on the reduced car."""
  twin = Twin(Vehicle.load(), threads=1)
  return twin_plant(twin, twin.parameters.nominal, "reduced")


class Integrator:
  """A car whose speed follows the voltage at once, 1 m/s a volt, and that turns by its steering angle a second."""

  def __init__(self, start: np.ndarray, commands: list):
    self.signals, self._commands = np.zeros((1, len(SIGNALS))), commands
    self.signals[0, :3] = start[0, :3]

  def step(self, commands: np.ndarray) -> np.ndarray:
    self._commands.append(commands[0].copy())
    row = self.signals[0].copy()
    row[3], row[5], row[9] = commands[0, 0], commands[0, 1], commands[0, 1]
    row[0] += 0.01 * row[3] * np.cos(row[2])
    row[1] += 0.01 * row[3] * np.sin(row[2])
    row[2] += 0.01 * row[5]
    row[8] = row[3] / (0.033 * Vehicle().gear_ratio)
    self.signals = row[None]
    return self.signals


def by_hand() -> tuple[OnboardPlant, list]:
  """The integrator as a plant, and the commands it has got so far."""
  commands: list = []
  vehicle = Vehicle()
  return OnboardPlant(lambda start: Integrator(start, commands), vehicle, {"mass": 2.7}, {}, "by hand"), commands


def drive_text(folder: Path, text: str, plant: OnboardPlant | None = None, **terms: object) -> Drive:
  """Drive a script given as text."""
  script = folder / "script.py"
  script.write_text(textwrap.dedent(text), encoding="utf-8")
  return drive(script, plant or reduced(), Terms(**terms))  # type: ignore[arg-type]
