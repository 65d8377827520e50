"""Conceal formulas that the catalogue does not hold, and see what comes out.

qcar-twin benchmark-formula --cars 16 --second 16 --each 1 --seed 900 --jobs 16
"""

import dataclasses
from pathlib import Path

from joblib import delayed

from calibration.concealed.benchmarks.formula import attempt, cases_of, file_of, read_case
from calibration.concealed.benchmarks.formula_page import page
from calibration.concealed.benchmarks.hidden_formulas import FORMULAS
from calibration.progress import counted
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.parallel import in_parallel

OUT_IS_FILE = True
KEPT = "cases that were finished stay in --work, the same command goes on with the others"


@dataclasses.dataclass(frozen=True)
class Config:
  """Sessions of the independent cars with one concealed formula each, and one of each car without."""

  work: Path = Path("out/formulas")
  """Folder of the cases. Those that are in it are kept."""
  out: Path = Path("docs/results/formula.md")
  """Markdown page to write; a picture of some cases goes next to it."""
  seed: int = 71
  """Seed of the first car; the others follow it."""
  cars: int = 1
  """Number of first independent cars."""
  second: int = 0
  """Number of second independent cars, into whose motor nothing is hidden."""
  formulas: tuple[str, ...] = tuple(FORMULAS)
  """Formulas to conceal; a session without any is always tried."""
  each: int = 0
  """Formulas per car, in turn; 0 for all."""
  jobs: int = 1
  """Number of cars at a time, one core each."""
  score_only: bool = False
  """Look for nothing and write the page of the cases that are there."""
  quick: bool = False
  """One first car, the first formula, and the session without any."""


def main(config: Config) -> str:
  """Do what is left and write the page."""
  if config.quick:
    config = dataclasses.replace(config, cars=1, second=0, formulas=config.formulas[:1])
  cars = cases_of(config.seed, config.cars, config.second, config.formulas, config.each)
  files = [file_of(config.work, car, seed, name) for car, seed, names in cars for name in names]
  said: list[str] = []
  if not config.score_only:
    calls = [delayed(attempt)(config.work, *one) for one in cars]
    said = [line for _, line in counted(in_parallel(calls, config.jobs), len(calls), "car")]
  done = [read_case(file) for file in files if file.is_file()]
  text = page(command(config), done, len(files), config.out.with_suffix(".png"))
  write_text(config.out, text)
  if failed := sorted(line for line in said if line):
    raise RuntimeError(
      f"no answer for {'; '.join(failed)}. The others are on the page; {config.work}/*.error.txt say where it arose,"
      " and the same command tries again"
    )
  return text


def command(config: Config) -> str:
  """The command that asks for these cases."""
  return (
    f"qcar-twin benchmark-formula --seed {config.seed} --cars {config.cars} --second {config.second} --each"
    f" {config.each}\n--formulas {' '.join(config.formulas)}"
  )


if __name__ == "__main__":
  run_script()
