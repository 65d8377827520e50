"""Time the twin and its fit in pairs that take turns in one process.

qcar-twin benchmark --out docs/results/speed.md
"""

import dataclasses
from pathlib import Path

from calibration.concealed.benchmarks.fit import fit_pairs
from calibration.concealed.benchmarks.speed import Pair, overhead_pair, threads_pair, tyre_pairs
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

PAGE = """# Speed, in pairs

`qcar-twin benchmark --out docs/results/speed.md`; both sides of a line ran in one process on two cores.
Ratios are medians of the ratios of rounds in which the sides take turns (fits run once each), times are medians;
processor time where one thread works, wall time for two threads and for the fits.

{table}

The fits start together and have the same residual (tested equal to 1e-3 of a standard deviation), parameters,
recordings and step of 2 ms, which is what the commands use, each with its tool's default settings. MuJoCo's
profiling clock is stopped on both sides, as the twin does it. {fits}
"""

LIBRARY = "The first side is the library itself, `mujoco.sysid.optimize` with its default optimiser."
WITHOUT = (
  "The packages that `mujoco.sysid` asks for (`mujoco[sysid]`) were not installed, so the first side is its default"
  " optimiser on models compiled per column, without its library."
)

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Eight ratios with their goals. Run it on a quiet machine."""

  out: Path
  """Markdown file to write."""
  rounds: int = 41
  """Number of turns that each side of a pair takes; each lasts 10 to 100 ms."""
  seed: int = 0
  """Seed of the drives and of the noise in the fits."""
  quick: bool = False
  """Five turns, and fits to two recordings of 1 s."""


TITLES = ("what", "sides", "first [us]", "second [us]", "per", "first / second", "goal", "")


def row(pair: Pair) -> tuple[str, ...]:
  """One line of the table."""
  first, second = (f"{1e6 * s:.4g}" for s in pair.seconds)
  said = "reached" if pair.reached else "missed"
  note = f"{said}; {pair.note}" if pair.note else said
  return (pair.name, ", ".join(pair.sides), first, second, pair.unit, f"{pair.ratio:.2f}", pair.aim, note)


def main(config: Config) -> tuple[Pair, ...]:
  """Time the pairs, print them and write the page."""
  rounds = 5 if config.quick else config.rounds
  fits = fit_pairs(2, 1.0, config.seed) if config.quick else fit_pairs(seed=config.seed)
  pairs = (*tyre_pairs(rounds), overhead_pair(rounds), threads_pair(rounds), *fits)
  print("\n".join(str(pair) for pair in pairs))
  library = any("library" not in side and "sysid" in side for side in fits[0].sides)
  text = PAGE.format(table="\n".join(markdown.table(TITLES, map(row, pairs))), fits=LIBRARY if library else WITHOUT)
  write_text(config.out, text)
  return pairs


if __name__ == "__main__":
  run_script()
