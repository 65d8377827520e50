"""Fit the weights of the decision to answers of campaigns, and write levels.toml.

qcar-twin set-levels --archives data/answers/scored.jsonl.xz --out out/levels.toml
"""

import dataclasses
import tempfile
from pathlib import Path

from calibration.concealed.campaign.archive import read_answer, unpack
from calibration.concealed.campaign.set_levels import fitted_weights, write_weights
from calibration.diagnosis.decision.levels import FILE, read_levels
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Answers to fit to, as a campaign's --archive keeps them."""

  archives: tuple[Path, ...]
  """Archives of answers; none of these cases may be counted when the outcome is measured."""
  out: Path
  """File of levels to write, complete, with the fitted weights."""
  typical: bool = True
  """Whether an amplitude's share of its catalogue's typical size may count."""
  levels: Path = FILE
  """File of levels whose other numbers are taken over; the installed one by default."""


def main(config: Config) -> str:
  """Fit and write; returns the weights."""
  results = []
  for archive in config.archives:
    with tempfile.TemporaryDirectory() as folder:
      unpack(archive, Path(folder))
      results += [read_answer(path) for path in sorted(Path(folder).glob("*.json"))]
  weights = fitted_weights(results, read_levels(config.levels), config.typical)
  options = " ".join(str(a) for a in config.archives) + ("" if config.typical else " --no-typical")
  command = f"qcar-twin set-levels --archives {options} --out {config.out.name}"
  write_text(config.out, config.levels.read_text(encoding="utf-8"))
  write_weights(weights, command, config.out)
  said = f"{len(results)} answers: " + ", ".join(f"{name} {value:.3f}" for name, value in weights.items())
  print(f"{said}; written to {config.out}")
  return said


if __name__ == "__main__":
  run_script()
