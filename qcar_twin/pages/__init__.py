"""Self-contained interactive HTML pages: `page` writes them, `charts` and `explorer` are what they are made of."""

from qcar_twin.pages.charts import Chart, Clip, bars, heat_map, line, panels, ranked
from qcar_twin.pages.explorer import Explorer, Line, Moment, Panel, Route, Run
from qcar_twin.pages.page import Cell, Section, Table, write_page

__all__ = [
  "Cell", "Chart", "Clip", "Explorer", "Line", "Moment", "Panel", "Route", "Run", "Section", "Table", "bars",
  "heat_map", "line", "panels", "ranked", "write_page",
]  # fmt: skip
