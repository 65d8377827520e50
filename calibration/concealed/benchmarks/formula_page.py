"""The page of cases with a concealed formula, and a picture of some of them."""

from collections.abc import Sequence
from pathlib import Path

from calibration.concealed.benchmarks.formula import Case, rates
from qcar_twin import markdown
from qcar_twin.plotting import new_figure, save

_TITLES = ("car", "concealed", "ships", "formula or table", "right place, right variables", "off, over the driving",
           "held-out errors", "can't be told from", "seconds")  # fmt: skip
_CAPTION = (
  "Force against the variable that it follows most, over pulses of 50 ms: recovered from what the base leaves over,"
  " what the formula or table says that was fitted in the simulator, and the truth where that acts on the same degree"
  " of freedom. The first cases that came out right, and the first that did not."
)
_RIGHT, _WRONG = 3, 2  # cases that are drawn


def page(command: str, done: Sequence[Case], asked: int, picture: Path) -> str:
  """Markdown of cases.

  Args:
    command: that they are of.
    done: cases that are finished.
    asked: how many there are to be.
    picture: file to draw some of them into, next to the page; none is written where there is nothing to draw.
  """
  worked = chosen(done)
  if worked:
    draw(worked, picture)
  lines = [
    "# A formula for what has no name",
    "",
    f"`{command}`: compact",
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
    *([f"\n![force against variable]({picture.name})", "", _CAPTION] if worked else []),
    "",
    "## What falls short, case by case",
    "",
    *([f"* {c.car} {c.seed}, {c.written}: {c.falls_short}. {c.said}" for c in done if c.falls_short] or ["Nothing."]),
  ]
  return "\n".join(lines) + "\n"


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


def _row(case: Case) -> tuple[str, ...]:
  """One case."""
  said = case.formula if case.ships else f"nothing: {case.why}"
  fall = f"{100.0 * (case.change - 1.0):+.0f} %" if case.ships else "–"
  off = "–" if case.error is None else f"{100.0 * case.error:.0f} %"
  words = ["yes" if right else "no" for right in (case.right_degree, case.right_variables)]
  right = ", ".join(words) if case.name and case.ships else "–"
  return (f"{case.car} {case.seed}", case.written, case.kind or "–", said, right, off, fall, case.alike or "–",
          f"{case.seconds:.0f}")  # fmt: skip
