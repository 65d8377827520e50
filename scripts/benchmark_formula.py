"""Conceal formulas that the catalogue does not hold, and see what comes out.

qcar-twin benchmark-formula --out docs/results/formula.md
"""

import dataclasses
from pathlib import Path

import numpy as np

from calibration.concealed.benchmarks.formula import Case, case_of, cases_of, rates, true_base
from calibration.concealed.benchmarks.hidden_formulas import FORMULAS
from calibration.diagnosis.formula.words import alike_words, equation
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script

OUT_IS_FILE = True


@dataclasses.dataclass(frozen=True)
class Config:
  """Sessions of the independent cars with one concealed formula each, and one of each car without."""

  out: Path = Path("docs/results/formula.md")
  """Markdown page to write."""
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
  quick: bool = False
  """One first car, the first formula, and the session without any."""


def main(config: Config) -> str:
  """Run it and write the page, after every case."""
  if config.quick:
    config = dataclasses.replace(config, cars=1, second=0, formulas=config.formulas[:1])
  done: list[Case] = []
  text = ""
  for kind, seed, names in cases_of(config.seed, config.cars, config.second, config.formulas, config.each):
    base = true_base(seed, kind)
    for name in ("", *names):
      case = case_of(base, kind, seed, name)
      print(f"{kind} {seed} {name or 'nothing'}: {case.said}", flush=True)
      done.append(case)
      text = page(config, done)
      write_text(config.out, text)
  return text


def page(config: Config, done: list[Case]) -> str:
  """The page of these cases."""
  lines = [
    "# A formula for what has no name",
    "",
    f"`qcar-twin benchmark-formula --seed {config.seed} --cars {config.cars} --second {config.second} --each"
    f" {config.each}",
    f"--formulas {' '.join(config.formulas)}`: compact",
    "sessions of the independent cars with one formula concealed at a time, at the base that the same car's session",
    "without it gives. So this measures finding a formula, not the diagnosis before it. A force along the car and a",
    "torque of the motor count as one place; off: root mean square difference to the true force over what was driven,",
    "over that of the true force; held-out errors: geometric mean over the channels; seconds of one core. Intervals",
    "are exact 95 % ones (Clopper and Pearson).",
    "",
    *markdown.table(("what", "how often", "95 % interval"), rates(done)),
    "",
    *markdown.table(_TITLES, [_row(case) for case in done]),
    "",
    "## What falls short, case by case",
    "",
    *([f"* {c.car} {c.seed}, {c.written}: {c.falls_short}. {c.said}" for c in done if c.falls_short] or ["Nothing."]),
  ]
  return "\n".join(lines) + "\n"


_TITLES = ("car", "concealed", "ships", "formula or table", "right place, right variables", "off, over the driving",
           "held-out errors", "can't be told from", "seconds")  # fmt: skip


def _row(case: Case) -> tuple[str, ...]:
  """One case."""
  rest = case.shipped.rest
  said = equation(rest) if case.ships else f"nothing: {rest.why or 'held-out errors grow'}"
  fall = f"{100.0 * (case.shipped.change - 1.0):+.0f} %" if case.ships else "–"
  off = "–" if np.isnan(case.error) else f"{100.0 * case.error:.0f} %"
  words = ["yes" if right else "no" for right in (case.right_degree, case.right_variables)]
  right = ", ".join(words) if case.name and case.ships else "–"
  return (f"{case.car} {case.seed}", case.written, rest.kind if case.ships else "–", said, right, off, fall,
          alike_words(rest) or "–", f"{case.seconds:.0f}")  # fmt: skip


if __name__ == "__main__":
  run_script()
