"""Conceal formulas that the catalogue does not hold, and see what comes out.

qcar-twin benchmark-formula --out docs/results/formula.md
"""

import dataclasses
from pathlib import Path

import numpy as np

from calibration.concealed.benchmarks.formula import FORMULAS, Tried, tried, true_base
from calibration.diagnosis.formula.words import alike_words, equation, sentence
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Sessions of the independent car with one concealed formula each, and one without."""

  out: Path = Path("docs/results/formula.md")
  """Markdown page to write."""
  seed: int = 71
  """Seed of the first car; the others follow it."""
  cars: int = 1
  """Number of cars."""
  formulas: tuple[str, ...] = tuple(FORMULAS)
  """Formulas to conceal; a session without any is always tried."""
  quick: bool = False
  """One car, the first formula, and the session without any."""


def row(seed: int, name: str, case: Tried) -> tuple[str, ...]:
  """One case."""
  rest = case.shipped.rest
  said = equation(rest) if case.shipped.kept else f"nothing: {rest.why or 'held-out errors grow'}"
  fall = f"{100.0 * (case.shipped.change - 1.0):+.0f} %" if case.shipped.kept else "–"
  off = "–" if np.isnan(case.error) else f"{100.0 * case.error:.0f} %"
  kind = rest.kind if case.shipped.kept else "–"
  truth = FORMULAS[name].written if name else "none"
  right = "–" if not (name and case.shipped.kept) else f"{_word(case.right_degree)}, {_word(case.right_variables)}"
  return str(seed), truth, kind, said, right, off, fall, alike_words(rest) or "–", f"{case.seconds:.0f}"


def _word(right: bool) -> str:
  return "yes" if right else "no"


def main(config: Config) -> str:
  """Run it and write the page, after every case."""
  cars, names = (1, config.formulas[:1]) if config.quick else (config.cars, config.formulas)
  rows: list[tuple[str, ...]] = []
  text = ""
  for seed in range(config.seed, config.seed + cars):
    base = true_base(seed)
    for name in ("", *names):
      case = tried(base, seed, name)
      print(f"{seed} {name or 'nothing'}: {sentence(case.shipped.rest, case.shipped.change)}", flush=True)
      rows.append(row(seed, name, case))
      text = page(config, cars, rows)
      write_text(config.out, text)
  return text


def page(config: Config, cars: int, rows: list[tuple[str, ...]]) -> str:
  """The page of these cases."""
  titles = ("car", "concealed", "ships", "formula or table", "right place, right variables", "off, over the driving",
            "held-out errors", "can't be told from", "seconds")  # fmt: skip
  lines = [
    "# A formula for what has no name",
    "",
    f"`qcar-twin benchmark-formula --seed {config.seed} --cars {cars} --formulas {' '.join(config.formulas)}`: compact",
    "sessions of the independent car with one formula concealed at a time, at the base that the same car's session",
    "without it gives. So this measures finding a formula, not the diagnosis before it. A force along the car and a",
    "torque of the motor count as one place; off: root mean square difference to the true force over what was driven,",
    "over that of the true force; held-out errors: geometric mean over the channels; seconds of one core.",
    "",
    *markdown.table(titles, rows),
  ]
  return "\n".join(lines) + "\n"


if __name__ == "__main__":
  run_script()
