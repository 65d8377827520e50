"""Conceal formulas that the catalogue does not hold, and see what comes out.

qcar-twin benchmark-formula --cars 16 --second 16 --each 1 --seed 900 --jobs 16
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from joblib import delayed

from calibration.concealed.benchmarks.formula import Case, attempt, cases_of, file_of, rates, read_case
from calibration.concealed.benchmarks.hidden_formulas import FORMULAS
from calibration.progress import counted
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text
from qcar_twin.command_line import run_script
from qcar_twin.parallel import in_parallel
from qcar_twin.plotting import new_figure, save

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
  text = page(config, done, len(files))
  write_text(config.out, text)
  if failed := sorted(line for line in said if line):
    raise RuntimeError(
      f"no answer for {'; '.join(failed)}. The others are on the page; {config.work}/*.error.txt say where it arose,"
      " and the same command tries again"
    )
  return text


def page(config: Config, done: list[Case], asked: int) -> str:
  """The page of these cases, with its picture."""
  worked = chosen(done)
  if worked:
    draw(worked, config.out.with_suffix(".png"))
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
    *([] if len(done) == asked else ["", f"{len(done)} of {asked} cases are done."]),
    "",
    *markdown.table(("what", "how often", "95 % interval"), rates(done)),
    "",
    *markdown.table(_TITLES, [_row(case) for case in done]),
    *([f"\n![force against variable]({config.out.with_suffix('.png').name})", "", _CAPTION] if worked else []),
    "",
    "## What falls short, case by case",
    "",
    *([f"* {c.car} {c.seed}, {c.written}: {c.falls_short}. {c.said}" for c in done if c.falls_short] or ["Nothing."]),
  ]
  return "\n".join(lines) + "\n"


_CAPTION = (
  "Force against the variable that it follows most, over pulses of 50 ms: recovered from what the base leaves over,"
  " what the formula or table says that was fitted in the simulator, and the truth where that acts on the same degree"
  " of freedom. The first cases that came out right, and the first that did not."
)
_RIGHT, _WRONG = 3, 2  # cases that are drawn


def chosen(done: Sequence[Case]) -> list[Case]:
  """Cases to draw: the first of different formulas that came out right, and the first others with a picture."""
  hidden = [c for c in done if c.name and c.picture]
  out: list[Case] = []
  for right, most in ((True, _RIGHT), (False, _WRONG)):
    first = {c.name: c for c in reversed(hidden) if (not c.falls_short) == right}
    out += [c for c in hidden if c in first.values()][:most]
  return out


def draw(cases: Sequence[Case], path: Path) -> None:
  """Force against variable of some cases."""
  figure, axes = new_figure(len(cases), 1, row_height=2.4)
  for ax, case in zip(axes[:, 0], cases, strict=True):
    picture = case.picture
    for who, size in (("recovered", 10), ("true", 8), ("told", 6)):
      if picture[who] is not None:
        ax.scatter(picture["at"], picture[who], s=size, label="formula or table" if who == "told" else who)
    ax.set_title(f"{case.car} {case.seed}: {case.written}; {case.falls_short or 'right'}", fontsize="small")
    ax.set_xlabel(picture["x"])
    ax.set_ylabel(picture["y"])
    ax.legend(fontsize="small")
  save(figure, path)


_TITLES = ("car", "concealed", "ships", "formula or table", "right place, right variables", "off, over the driving",
           "held-out errors", "can't be told from", "seconds")  # fmt: skip


def _row(case: Case) -> tuple[str, ...]:
  """One case."""
  said = case.formula if case.ships else f"nothing: {case.why}"
  fall = f"{100.0 * (case.change - 1.0):+.0f} %" if case.ships else "–"
  off = "–" if case.error is None else f"{100.0 * case.error:.0f} %"
  words = ["yes" if right else "no" for right in (case.right_degree, case.right_variables)]
  right = ", ".join(words) if case.name and case.ships else "–"
  return (f"{case.car} {case.seed}", case.written, case.kind or "–", said, right, off, fall, case.alike or "–",
          f"{case.seconds:.0f}")  # fmt: skip


if __name__ == "__main__":
  run_script()
