"""Compare the reduced car with MuJoCo's on a data set, and write a page.

qcar-twin benchmark-plant --dataset data/sample --out docs/results/fast_plant.md
"""

import dataclasses
from pathlib import Path

import numpy as np

from calibration.concealed.benchmarks.fast_plant import Agreement, compare_plants
from calibration.progress import StageLine
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.markdown import table
from qcar_twin.recordings.dataset import DataSet

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Differences between the reduced car, which fits search on, and MuJoCo's."""

  dataset: Path = Path("data/sample")
  """Folder with dataset.toml, in SI units."""
  out: Path = Path("docs/results/fast_plant.md")
  """Markdown page to write."""
  vectors: int = 50
  """Number of random parameter vectors."""
  seed: int = 0
  """Seed of the parameter vectors."""
  most: float = 300.0
  """Longest driving that is simulated, s."""


def main(config: Config) -> Agreement:
  """Measure and write."""
  dataset = DataSet.load(config.dataset)
  with StageLine() as progress:
    agreement = compare_plants(dataset, config.vectors, config.seed, config.most, progress)
  write_text(config.out, page(agreement, config))
  print(f"{agreement.speed}\npage: {config.out}")
  return agreement


def page(agreement: Agreement, config: Config) -> str:
  """The page's text."""
  first, second = (1e6 * s for s in agreement.speed.seconds)
  rows = [
    [n, f"{share:.2g}", f"{agreement.worst[n][1]:.2g} ({agreement.worst[n][0]})"]
    + [f"{np.quantile(agreement.drawn[n], q):.2g}" for q in (0.5, 0.9)]
    for n, share in agreement.channels.items()
  ]
  listed = lambda cosines: [[n, f"{a:.3f}", f"{b:.3f}"] for n, (a, b) in sorted(cosines.items(), key=lambda kv: kv[1])]
  apart = ", ".join(sorted({recording for recording, _ in agreement.worst.values()}))
  lines = [
    "# The reduced car against MuJoCo's",
    "",
    f"`qcar-twin benchmark-plant --dataset {config.dataset} --vectors {config.vectors} --seed {config.seed}"
    f" --most {config.most:g}`: {agreement.seconds:.0f} s of driving."
    " What the reduced car is: [reduced.md](../reference/reduced.md).",
    "",
    f"10 ms of one car, one thread, in pairs: {first:.1f} us in MuJoCo, {second:.2f} us on the reduced car,"
    f" {agreement.speed.ratio:.0f} times as fast.",
    "",
    "Root mean square of the difference in units of sensor noise, median of the recordings, at nominal parameters and"
    f" over {agreement.vectors} random vectors:",
    "",
    *table(["channel", "nominal", "its worst recording", "half of the random below", "nine of ten below"], rows),
    "",
    "Cosine between the slopes of both with respect to the base parameters (those worth a nat over their scale):",
    "",
    *table(["parameter", "all recordings", f"without {apart}"], listed(agreement.slopes)),
    "",
    "Cosine between what mechanisms of typical size change (those worth a nat):",
    "",
    *table(["mechanism", "all recordings", f"without {apart}"], listed(agreement.effects)),
    "",
  ]
  return "\n".join(lines)


if __name__ == "__main__":
  run_script()
