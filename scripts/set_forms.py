"""Measure how far the twin's own form moves figures of cars without any effect.

qcar-twin set-forms --seed 4000 --sessions 8 --out forms.toml
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from calibration.concealed.benchmarks.forms import all_form_deviations, fitted_figures
from calibration.concealed.benchmarks.known import CARS
from calibration.progress import counted
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.recordings.recording import nearest

OUT_IS_FILE = True
_HEAD = """\
# Form deviations: how far, as a share of its size, recalibration moves a figure of a car without any effect from what
# was measured, beyond the measurement's own deviation, or from its truth where only the simulator knows it, beyond that
# of the fit. "others" is the root mean square of the former. Written by the command.
"""


@dataclass(frozen=True)
class Config:
  """Recalibrate the twin on sessions without an effect of three generators."""

  out: Path
  """TOML file to write."""
  seed: int = 4000
  """Seed of the first session; the others follow it."""
  sessions: int = 8
  """Number of sessions of each generator."""
  cars: tuple[str, ...] = tuple(CARS)
  """Generators: first, second, slipx (extra `exam`)."""
  quick: bool = False
  """One session of the first car."""


def main(config: Config) -> Path:
  """Measure and write; returns the file."""
  for name in config.cars:
    if name not in CARS:
      raise KeyError(f"no generator '{name}'{nearest(name, CARS)}")
  cars, count = (config.cars[:1], 1) if config.quick else (config.cars, config.sessions)
  seeds = range(config.seed, config.seed + count)
  shares = all_form_deviations(list(counted(fitted_figures(cars, seeds), len(cars) * count, "session")))
  command = (
    f"qcar-twin set-forms --seed {config.seed} --sessions {count} --cars {' '.join(cars)} --out {config.out.name}"
  )
  entry = lambda name, value, of: (
    f'[{name}]\nvalue = {value:.4f}\nunit = "share of its size"\nsource = "{of} sessions of {", ".join(cars)}"\n'
    f'command = "{command}"\n'
  )
  text = "\n".join([_HEAD, *(entry(name, value, of) for name, (value, of) in shares.items())])
  write_text(config.out, text)
  print(text)
  return config.out


if __name__ == "__main__":
  run_script()
