"""Speed of the twin in pairs that run in turn in one process.

python scripts/benchmark.py --out docs/results_speed.md
"""

import dataclasses
from pathlib import Path

import tyro

from calibration.benchmark import control_period_against_steps, threads, tyre_against_native


@dataclasses.dataclass(frozen=True)
class Config:
  """Three ratios with their aims; run it on a quiet machine."""

  out: Path
  """Markdown file to write."""
  rounds: int = 60
  """Turns each side of a pair takes."""
  seed: int = 0
  """Nothing here draws."""
  quick: bool = False
  """Five turns only."""


def main(config: Config) -> None:
  """Time the pairs and write the table."""
  rounds = 5 if config.quick else config.rounds
  pairs = (tyre_against_native(rounds), control_period_against_steps(rounds=rounds), threads(rounds=rounds))
  lines = ["| pair | ours [us] | theirs [us] | ratio | aim |", "|---|---|---|---|---|"]
  for pair in pairs:
    lines.append(
      f"| {pair.name} | {1e6 * pair.ours:.1f} | {1e6 * pair.theirs:.1f} | {pair.ratio:.2f} | <= {pair.aim:.2f} |"
    )
  text = "\n".join(lines) + "\n"
  temporary = config.out.with_suffix(".part")
  temporary.write_text(text, encoding="utf-8")
  temporary.replace(config.out)
  print(text)


if __name__ == "__main__":
  main(tyro.cli(Config))
