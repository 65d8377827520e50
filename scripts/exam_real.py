"""Put known changes into real recordings, halve them, and see what a comparison then says.

qcar-twin exam-real --dataset ../shared/data/dart --out out/real_dart --injections 24 --splits 10
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from calibration.concealed.injection.page import page
from calibration.concealed.injection.trials import Bench, kept
from calibration.progress import counted
from qcar_twin.atomic_io import plain, write_text
from qcar_twin.command_line import run_script
from qcar_twin.recordings.dataset import DataSet

KEPT = "trials that were finished stay in --out, the same command goes on with the others"


@dataclass(frozen=True)
class Config:
  """Injections into a real data set, and halves of it that differ in nothing. Stops and resumes."""

  dataset: Path
  """Folder with dataset.toml."""
  out: Path
  """Folder of fits, trials.ndjson and real.md; what is there is not made again."""
  injections: int = 24
  """Number of injections, all kinds in turn."""
  splits: int = 10
  """Number of pairs of halves."""
  most: float = 60.0
  """Driving that each fit simulates, s."""
  seed: int = 1
  """Seed of sizes and halves."""


def main(config: Config) -> Path:
  """Make what is missing, write the page; returns its path."""
  dataset = DataSet.load(config.dataset)
  bench = Bench(dataset, config.out, config.most, config.seed)
  wanted = [("injection", i) for i in range(config.injections)] + [("split", i) for i in range(config.splits)]
  there = {trial["trial"] for trial in kept(config.out)}
  todo = [(kind, i) for kind, i in wanted if f"{kind}_{i:03d}" not in there]
  config.out.mkdir(parents=True, exist_ok=True)
  made = ((i, bench.injection(i) if kind == "injection" else bench.split(i)) for kind, i in todo)
  with (config.out / "trials.ndjson").open("a", encoding="utf-8") as file:
    for _, trial in counted(made, len(todo), "trial"):
      file.write(json.dumps(plain(trial)) + "\n")
      file.flush()
  command = (
    f"qcar-twin exam-real --dataset {config.dataset.name} --injections {config.injections} --splits {config.splits}"
    f" --most {config.most:g} --seed {config.seed}"
  )
  text = page(dataset.name, kept(config.out), command)
  write_text(config.out / "real.md", text)
  print(text)
  return config.out / "real.md"


if __name__ == "__main__":
  run_script()
