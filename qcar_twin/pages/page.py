"""One self-contained HTML page: verdict first, then sections of text, tables, charts, explorers and films.

Everything is inside the file, plotly.js included: the page forbids itself to fetch anything. All text is escaped.

  write_page("out/report.html", "Calibration", "The twin answers within 0.8 %.", [Section("Steps", "…")])
"""

import dataclasses
import functools
import json
import math
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import jinja2
from markupsafe import Markup

from qcar_twin.atomic_io import plain, write_text
from qcar_twin.pages.charts import Chart, Clip
from qcar_twin.pages.explorer import Explorer
from qcar_twin.plotting import HEAT, PALETTE

Cell = str | float | int | bool | None
Figure = Chart | Explorer | Clip
Tone = Literal["plain", "good", "partly", "bad"]

_HERE = Path(__file__).parent
_LONG = 16  # rows of a table that is folded away
_TEMPLATES = jinja2.Environment(
  loader=jinja2.FileSystemLoader(_HERE),
  autoescape=True,
  undefined=jinja2.StrictUndefined,
  trim_blocks=True,
  lstrip_blocks=True,
)


@dataclasses.dataclass(frozen=True)
class Table:
  """Rows of cells under column titles; units belong in the titles. A long one is folded unless `unfolded`."""

  caption: str
  columns: Sequence[str]
  rows: Sequence[Sequence[Cell]]
  unfolded: bool = False

  def __post_init__(self) -> None:
    for number, row in enumerate(self.rows):
      if len(row) != len(self.columns):
        raise ValueError(f"table '{self.caption}', row {number}: {len(row)} cells for {len(self.columns)} columns")

  @property
  def folded(self) -> bool:
    """Whether a reader has to open it: tables of more than 16 rows, unless they are to be seen at once."""
    return len(self.rows) > _LONG and not self.unfolded


@dataclasses.dataclass(frozen=True)
class Section:
  """A titled part of the page: text, figures, tables.

  Blank lines part the text into paragraphs; lines that start with "* " make a list.
  """

  title: str
  text: str = ""
  tables: Sequence[Table] = ()
  figures: Sequence[Figure] = ()


def write_page(
  path: str | os.PathLike[str],
  title: str,
  verdict: str,
  sections: Iterable[Section],
  subtitle: str = "",
  facts: Sequence[tuple[str, str]] = (),
  tone: Tone = "plain",
) -> Path:
  """Write the page, whole or not at all.

  Args:
    path: file to write.
    title: of the page.
    verdict: the outcome in one plain sentence; shown first.
    sections: parts, in order; each gets an entry in the list of contents.
    subtitle: what was looked at: data set, car, seed.
    facts: a few numbers that go with the verdict: what, how much.
    tone: the colour next to the verdict.
  """
  if not verdict.strip():
    raise ValueError("a report starts with its verdict; give one sentence")
  parts = tuple(sections)
  figures = [figure for part in parts for figure in part.figures]
  drawn = any(isinstance(figure, (Chart, Explorer)) for figure in figures)
  text = _TEMPLATES.get_template("page.html").render(
    title=title,
    subtitle=subtitle,
    verdict=verdict,
    facts=facts,
    tone=tone,
    sections=parts,
    anchors=_anchors([part.title for part in parts]),
    stepping=any(isinstance(figure, Explorer) and figure.moments for figure in figures),
    exploring=any(isinstance(figure, Explorer) for figure in figures),
    comparing=any(isinstance(figure, Explorer) and figure.comparable for figure in figures),
    filmed=any(isinstance(figure, Clip) for figure in figures),
    kind=lambda figure: {Chart: "chart", Explorer: "explorer", Clip: "clip"}[type(figure)],
    as_json=_as_json,
    blocks=_blocks,
    show=show,
    numeric=_numeric,
    style=Markup(_style()),
    script=Markup(_file("page.js")),
    plotly=Markup(_plotly()) if drawn else "",
  )
  return write_text(path, text)


@functools.cache
def _plotly() -> str:
  """Source of plotly.js, from the wheel."""
  from plotly.offline import get_plotlyjs  # a tenth of a second, for pages with charts only

  return get_plotlyjs().replace("</script", "<\\/script")


@functools.cache
def _file(name: str) -> str:
  return (_HERE / name).read_text(encoding="utf-8")


def _style() -> str:
  """The style sheet, with the house's colours on light and on dark as variables."""
  scale = {f"heat-{i}": pair for i, pair in enumerate(zip(*HEAT, strict=True))}
  sets = [" ".join(f"--{name}: {pair[i]};" for name, pair in {**PALETTE, **scale}.items()) for i in range(2)]
  light, dark = sets
  return (
    f":root {{ color-scheme: light; {light} }}\n"
    f"@media (prefers-color-scheme: dark) {{ :root:not([data-theme=light]) {{ color-scheme: dark; {dark} }} }}\n"
    f":root[data-theme=dark] {{ color-scheme: dark; {dark} }}\n" + _file("page.css")
  )


def _as_json(figure: Chart | Explorer) -> Markup:
  """A figure's data for a script element: no character that could end it."""
  text = json.dumps(plain(figure.data()), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
  return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def show(cell: Cell) -> str:
  """A cell as text: three to four significant digits, yes and no, a dash for what is unknown."""
  if cell is None or (isinstance(cell, float) and math.isnan(cell)):
    return "–"
  if isinstance(cell, bool):
    return "yes" if cell else "no"
  if isinstance(cell, str):
    return cell
  if float(cell) == int(cell) if math.isfinite(float(cell)) else False:
    return f"{int(cell):d}".replace("-", "\u2212") if abs(cell) < 1e6 else f"{cell:.4g}"
  return f"{cell:.{0 if 1e4 <= abs(cell) < 1e6 else 4}{'f' if 1e4 <= abs(cell) < 1e6 else 'g'}}".replace("-", "\u2212")


def _numeric(cell: Cell) -> bool:
  return not isinstance(cell, (str, bool))


def _anchors(titles: Sequence[str]) -> list[str]:
  """A unique id for each title."""
  used: set[str] = set()
  anchors = []
  for number, title in enumerate(titles):
    slug = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") or "section"
    anchors.append(slug if slug not in used else f"{slug}-{number}")
    used.add(anchors[-1])
  return anchors


def _blocks(text: str) -> list[tuple[str, list[str]]]:
  """Text as ("paragraph", [text]) and ("list", items)."""
  blocks = []
  for part in re.split(r"\n\s*\n", text.strip()):
    lines = [line.strip() for line in part.splitlines() if line.strip()]
    plain = [line for line in lines if not line.startswith("* ")]
    items = [line[2:] for line in lines if line.startswith("* ")]
    blocks += [("paragraph", [" ".join(plain)])] if plain else []
    blocks += [("list", items)] if items else []
  return blocks
