"""One self-contained HTML page: verdict first, then sections of text, tables and figures.

Everything is inside the file: no script, no style sheet, no picture is fetched. All text is escaped.

  write_page("out/report.html", "Calibration", "The twin answers within 0.8 %.", [Section("Steps", "…")])
"""

import base64
import dataclasses
import io
import math
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import jinja2
from matplotlib.figure import Figure

from qcar_twin.atomic_io import write_text
from qcar_twin.plotting import house

Cell = str | float | int | bool | None

_TYPES = {"png": "image/png", "svg": "image/svg+xml"}
_TEMPLATES = jinja2.Environment(
  loader=jinja2.FileSystemLoader(Path(__file__).parent),
  autoescape=True,
  undefined=jinja2.StrictUndefined,
  trim_blocks=True,
  lstrip_blocks=True,
)


@dataclasses.dataclass(frozen=True)
class Table:
  """Rows of cells under column titles; units belong in the titles."""

  caption: str
  columns: Sequence[str]
  rows: Sequence[Sequence[Cell]]

  def __post_init__(self) -> None:
    for number, row in enumerate(self.rows):
      if len(row) != len(self.columns):
        raise ValueError(f"table '{self.caption}', row {number}: {len(row)} cells for {len(self.columns)} columns")


@dataclasses.dataclass(frozen=True)
class Picture:
  """An image with its caption: PNG or SVG bytes."""

  image: bytes
  caption: str
  kind: Literal["png", "svg"] = "png"

  @property
  def uri(self) -> str:
    """The image as a data URI."""
    return f"data:{_TYPES[self.kind]};base64,{base64.b64encode(self.image).decode('ascii')}"


@dataclasses.dataclass(frozen=True)
class Section:
  """A titled part of the page. Blank lines part the text into paragraphs; lines that start with "* " make a list."""

  title: str
  text: str = ""
  tables: Sequence[Table] = ()
  figures: Sequence[Picture] = ()


def picture(figure: Figure, caption: str, kind: Literal["png", "svg"] = "png", dpi: int = 130) -> Picture:
  """A matplotlib figure as bytes; SVG for a few hundred points, PNG for long records."""
  buffer = io.BytesIO()
  with house():
    figure.savefig(buffer, format=kind, dpi=dpi, metadata={"Date": None} if kind == "svg" else None)
  return Picture(buffer.getvalue(), caption, kind)


def write_page(
  path: str | os.PathLike[str],
  title: str,
  verdict: str,
  sections: Iterable[Section],
  subtitle: str = "",
) -> Path:
  """Write the page, whole or not at all.

  Args:
    path: file to write.
    title: of the page.
    verdict: the outcome in one plain sentence; shown first.
    sections: parts, in order; each gets an entry in the list of contents.
    subtitle: what was looked at: data set, car, seed.
  """
  if not verdict.strip():
    raise ValueError("a report starts with its verdict; give one sentence")
  parts = tuple(sections)
  text = _TEMPLATES.get_template("page.html").render(
    title=title,
    subtitle=subtitle,
    verdict=verdict,
    sections=parts,
    anchors=_anchors([part.title for part in parts]),
    blocks=_blocks,
    show=show,
    numeric=_numeric,
  )
  return write_text(path, text)


def show(cell: Cell) -> str:
  """A cell as text: three to four significant digits, yes and no, a dash for what is unknown."""
  if cell is None or (isinstance(cell, float) and math.isnan(cell)):
    return "–"
  if isinstance(cell, bool):
    return "yes" if cell else "no"
  if isinstance(cell, str):
    return cell
  if float(cell) == int(cell) if math.isfinite(float(cell)) else False:
    return f"{int(cell):d}" if abs(cell) < 1e6 else f"{cell:.4g}"
  return f"{cell:.4g}".replace("-", "\u2212")


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
