"""Charts and films of a page, as plain data in the form plotly.js takes.

A colour is written by its name in `qcar_twin.plotting.PALETTE`, "@twin", or "@twin/0.2" with its opacity, so that the
page can draw the same chart on light and on dark; "@heat" is the scale from little to much. Arrays travel as 32-bit
floats in base64, which keeps seven digits in five and a half characters.
"""

import base64
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Trace = Mapping[str, Any]
_EXACT = 4096.0  # s; beyond it 32 bits tell times apart by half a millisecond only


@dataclasses.dataclass(frozen=True)
class Chart:
  """A plotly figure with its caption.

  Attributes:
    traces, layout: as plotly.js takes them.
    height: pixels.
  """

  caption: str
  traces: Sequence[Trace]
  layout: Mapping[str, Any]
  height: int = 320

  def data(self) -> dict[str, Any]:
    """What the page's script draws."""
    return {"kind": "chart", "traces": list(self.traces), "layout": dict(self.layout), "height": self.height}


@dataclasses.dataclass(frozen=True)
class Clip:
  """A film, mp4 (H.264), with its caption; `still` is a JPEG that stands in for it before it plays and in print."""

  film: bytes
  caption: str
  still: bytes = b""

  @property
  def film_uri(self) -> str:
    """The film as a data URI."""
    return f"data:video/mp4;base64,{base64.b64encode(self.film).decode('ascii')}"

  @property
  def still_uri(self) -> str:
    """The still as a data URI; "" without one."""
    return f"data:image/jpeg;base64,{base64.b64encode(self.still).decode('ascii')}" if self.still else ""


def packed(values: ArrayLike) -> dict[str, str]:
  """Numbers as plotly.js's typed arrays; NaN and infinity leave gaps."""
  array = np.asarray(values, dtype=np.float64)
  finite = np.where(np.isfinite(array), array, np.nan)
  wide = bool(np.any(np.abs(finite) > _EXACT))
  raw = np.ascontiguousarray(finite, dtype="<f8" if wide else "<f4").tobytes()
  return {"dtype": "f8" if wide else "f4", "bdata": base64.b64encode(raw).decode("ascii")}


def unpacked(data: Mapping[str, str]) -> NDArray[np.float64]:
  """The numbers that `packed` made, as the page reads them."""
  return np.frombuffer(base64.b64decode(data["bdata"]), dtype=f"<{data['dtype']}").astype(np.float64)


def line(x: ArrayLike, y: ArrayLike, who: str, label: str = "", **more: Any) -> dict[str, Any]:
  """A line in the colour of `who`; its name is the label unless given. `more` are further keys of the trace."""
  name = label or who
  style = {"color": f"@{who}", "width": 1.2 if who == "measured" else 1.8} | more.pop("style", {})
  return {
    "type": "scatter", "mode": "lines", "x": packed(x), "y": packed(y), "name": name, "legendgroup": name,
    "line": style, **more,
  }  # fmt: skip


def axis(title: str, **more: Any) -> dict[str, Any]:
  """An axis with its title."""
  return {"title": {"text": title}, **more}


def bars(
  caption: str,
  groups: Sequence[str],
  values: Mapping[str, Sequence[float]],
  title: str,
  bounds: Mapping[str, tuple[Sequence[float], Sequence[float]]] | None = None,
  level: tuple[float, str] | None = None,
  labels: Mapping[str, str] | None = None,
) -> Chart:
  """Bars side by side in groups, one colour for each of "before", "twin", "bicycle"; NaN leaves a gap.

  Args:
    title: of the vertical axis.
    bounds: lower and upper ends of an interval about some of them.
    level: a line across with its name.
    labels: names where a colour's own does not do.
  """
  traces = []
  for who, heights in values.items():
    name = (labels or {}).get(who, who)
    trace: dict[str, Any] = {"type": "bar", "name": name, "x": list(groups), "y": _plain(heights),
                             "marker": {"color": f"@{who}"}, "hovertemplate": "%{x}: %{y:.3g}"}  # fmt: skip
    if bounds and who in bounds:
      low, high = (np.asarray(b, dtype=float) for b in bounds[who])
      centre = np.asarray(heights, dtype=float)
      trace["error_y"] = {"type": "data", "symmetric": False, "array": _plain(high - centre),
                          "arrayminus": _plain(centre - low), "color": "@ink", "thickness": 1.2}  # fmt: skip
    traces.append(trace)
  layout: dict[str, Any] = {
    "barmode": "group",
    "bargap": 0.35,
    "yaxis": axis(title, rangemode="tozero"),
    "xaxis": {"type": "category"},
  }
  if level is not None:
    layout["shapes"] = [{"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": level[0], "y1": level[0],
                         "line": {"color": "@note", "width": 1, "dash": "dot"}}]  # fmt: skip
    layout["annotations"] = [{"xref": "paper", "x": 1, "y": level[0], "text": level[1], "showarrow": False,
                              "xanchor": "right", "yanchor": "bottom", "font": {"color": "@note"}}]  # fmt: skip
  return Chart(caption, traces, layout)


def ranked(caption: str, rows: Sequence[tuple[str, float, str, bool]], title: str) -> Chart:
  """Horizontal bars, first on top: name, length, whose colour, and whether it is hatched."""
  trace = {
    "type": "bar",
    "orientation": "h",
    "y": [name for name, *_ in rows],
    "x": _plain([max(value, 0.0) for _, value, *_ in rows]),
    "text": [f"{value:.0f}" for _, value, *_ in rows],
    "textposition": "outside",
    "cliponaxis": False,
    "marker": {
      "color": [f"@{who}" for _, _, who, _ in rows],
      "pattern": {"shape": ["/" if hatched else "" for *_, hatched in rows], "fgcolor": "@paper"},
    },
    "hovertemplate": "%{y}: %{x:.1f}<extra></extra>",
  }
  layout = {
    "xaxis": axis(title),
    "yaxis": {"autorange": "reversed", "automargin": True, "showgrid": False, "type": "category"},
    "showlegend": False,
  }
  return Chart(caption, [trace], layout, 70 + 22 * max(len(rows), 3))


def heat_map(
  caption: str,
  columns: Sequence[str],
  rows: Sequence[str],
  values: ArrayLike,
  titles: tuple[str, str, str],
  limits: tuple[float, float] | None = None,
) -> Chart:
  """A table as colours with its numbers written in; NaN stays empty.

  Args:
    columns, rows: names, (c,) and (r,).
    values: (r, c).
    titles: of the columns, the rows, and the values.
    limits: values that have the first and the last colour.
  """
  table = np.asarray(values, dtype=float)
  text = [["" if not np.isfinite(v) else f"{v:.3g}" for v in row] for row in table]
  trace = {"type": "heatmap", "x": list(columns), "y": list(rows), "z": [_plain(row) for row in table], "text": text,
           "texttemplate": "%{text}", "colorscale": "@heat", "xgap": 1, "ygap": 1,
           "colorbar": {"title": {"text": titles[2]}, "thickness": 12, "outlinewidth": 0},
           "hovertemplate": f"{titles[1]} %{{y}}, {titles[0]} %{{x}}: %{{z:.3g}}<extra></extra>"}  # fmt: skip
  if limits:
    trace |= {"zmin": limits[0], "zmax": limits[1]}
  layout = {
    "xaxis": axis(titles[0], type="category", automargin=True, showgrid=False),
    "yaxis": axis(titles[1], type="category", automargin=True, showgrid=False),
  }
  return Chart(caption, [trace], layout, 140 + 30 * len(rows))


def panels(
  caption: str,
  parts: Sequence[tuple[str, str, Sequence[Trace]]],
  x_title: str | Sequence[str],
  columns: int = 2,
  height: int = 230,
) -> Chart:
  """Small charts in rows: (heading, vertical title, traces) of each.

  Args:
    x_title: of all, or of each.
    height: of a row, pixels.
  """
  columns = min(columns, max(len(parts), 1))
  rows = -(-len(parts) // columns)
  layout: dict[str, Any] = {"grid": {"rows": rows, "columns": columns, "pattern": "independent", "ygap": 0.36,
                                     "xgap": 0.16}, "annotations": [], "margin": {"l": 56, "r": 16, "t": 64, "b": 44},
                            "legend": {"orientation": "h", "x": 0, "xanchor": "left", "yref": "container", "y": 0.995,
                                       "yanchor": "top"}}  # fmt: skip
  traces: list[dict[str, Any]] = []
  seen: set[str] = set()
  for number, (heading, y_title, own) in enumerate(parts):
    mark = "" if number == 0 else str(number + 1)
    for trace in own:
      name = trace.get("name", "")
      traces.append({**trace, "xaxis": f"x{mark}", "yaxis": f"y{mark}", "showlegend": bool(name) and name not in seen})
      seen.add(name)
    below = x_title if isinstance(x_title, str) else x_title[number]
    layout[f"xaxis{mark}"], layout[f"yaxis{mark}"] = axis(below), axis(y_title)
    layout["annotations"].append(
      {"xref": f"x{mark} domain", "yref": f"y{mark} domain", "x": 0, "y": 1.02, "text": heading, "showarrow": False,
       "xanchor": "left", "yanchor": "bottom", "font": {"size": 13}}
    )  # fmt: skip
  return Chart(caption, traces, layout, 80 + height * rows)


def _plain(values: ArrayLike) -> list[float | None]:
  """Numbers for JSON, with four digits; None for what is not finite."""
  return [float(f"{v:.5g}") if np.isfinite(v) else None for v in np.asarray(values, dtype=float)]
