"""Tables of the pages in docs/, as Markdown."""

from collections.abc import Iterable, Sequence


def table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
  """Lines of a table in GitHub's Markdown (GFM 4.10); bars inside a cell are escaped.

  Raises:
    ValueError: a row has more or fewer cells than there are titles.
  """
  body = [list(row) for row in rows]
  for number, row in enumerate(body):
    if len(row) != len(titles):
      raise ValueError(f"row {number} of the table '{titles[0]}': {len(row)} cells for {len(titles)} titles")
  return [_line(titles), "|" + "---|" * len(titles), *map(_line, body)]


def _line(cells: Iterable[str]) -> str:
  return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
