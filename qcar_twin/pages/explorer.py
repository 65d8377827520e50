"""The explorer of a drive: channels of a recording on one time axis next to the map of where the car went.

Clicking the map moves the channels to that moment; pointing at the channels shows the place on the map. Where lines of
a panel share the clock of what was measured, their errors can be shown instead.

  Explorer("…", [Run("run_1", [Panel("yaw rate [rad/s]", [Line("measured", t, r), Line("twin", t, q)])])])
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.pages.charts import packed

Array = NDArray[np.float64]
ROOM = 200_000  # numbers of an explorer's channels, about: a megabyte of the page
_FEW = 300  # samples of a line that is never thinned
SPOTS = 4_000  # places on a map at most


@dataclasses.dataclass(frozen=True)
class Line:
  """One signal: whose it is ("measured", "before", "twin", …), times [s] and values, (N,); NaN leaves a gap.

  Attributes:
    label: in the legend; `who` unless given.
    spread: half the width of a band about it, (N,).
    dots: draw samples and no line.
  """

  who: str
  time: Array
  value: Array
  label: str = ""
  spread: Array | None = None
  dots: bool = False


@dataclasses.dataclass(frozen=True)
class Panel:
  """Signals on one vertical axis.

  Attributes:
    title: of the axis, with its unit.
    noise: standard deviation of the sensor, shaded about zero where errors are shown.
  """

  title: str
  lines: Sequence[Line]
  noise: float = 0.0


@dataclasses.dataclass(frozen=True)
class Route:
  """Where the car was: times [s], x, y [m] and what the map is coloured by, (N,) each."""

  time: Array
  x: Array
  y: Array
  level: Array | None = None


@dataclasses.dataclass(frozen=True)
class Run:
  """A recording: its panels in order, where it went, and seconds (from, to) that are shaded."""

  name: str
  panels: Sequence[Panel]
  route: Route | None = None
  note: str = ""
  shaded: Sequence[tuple[float, float]] = ()

  @property
  def seconds(self) -> float:
    """From the first sample of any line to the last."""
    times = [ln.time[np.isfinite(ln.time)] for panel in self.panels for ln in panel.lines]
    known = np.concatenate([t for t in times if len(t)] or [np.zeros(1)])
    return float(np.ptp(known))


@dataclasses.dataclass(frozen=True)
class Moment:
  """Seconds of a run worth a look, and why."""

  run: str
  start: float
  end: float
  text: str = ""


@dataclasses.dataclass(frozen=True)
class Explorer:
  """Runs to look at, moments to step through.

  Attributes:
    level: what the map is coloured by, with its unit; "" for one colour.
    shade: what is shaded.
    guides: lines drawn on the map: x, y, name.
    room: numbers of channels that are kept, about.
  """

  caption: str
  runs: Sequence[Run]
  moments: Sequence[Moment] = ()
  level: str = ""
  shade: str = ""
  guides: Sequence[tuple[Array, Array, str]] = ()
  room: int = ROOM

  @property
  def stride(self) -> int:
    """Every so many samples are kept."""
    total = sum(len(ln.value) * (1 if ln.spread is None else 2) for r in self.runs for p in r.panels for ln in p.lines)
    return max(1, -(-total // self.room))

  @property
  def comparable(self) -> bool:
    """Whether errors can be shown: something was measured on the clock of something else."""
    panels = [panel for run in self.runs for panel in run.panels]
    measured = [(ln, panel) for panel in panels for ln in panel.lines if ln.who == "measured"]
    return any(other.time is ln.time for ln, panel in measured for other in panel.lines if other is not ln)

  @property
  def full_caption(self) -> str:
    """The caption with what a reader must know of the thinning."""
    if self.stride == 1:
      return self.caption
    return f"{self.caption} Drawn is {ordinal(self.stride)} sample of long lines; tables use all."

  def data(self) -> dict[str, Any]:
    """What the page's script draws."""
    places = sum(len(r.route.time) for r in self.runs if r.route)
    apart = max(1, -(-places // SPOTS))
    names = [r.name for r in self.runs]
    return {
      "kind": "explorer",
      "runs": [_run(r, self.stride, apart) for r in self.runs],
      "moments": [{"run": names.index(m.run), "start": m.start, "end": m.end, "text": m.text}
                  for m in self.moments if m.run in names],
      "comparable": self.comparable,
      "level": self.level,
      "shade": self.shade,
      "guides": [{"x": packed(x), "y": packed(y), "name": name} for x, y, name in self.guides],
    }  # fmt: skip


def ordinal(stride: int) -> str:
  """ "every 2nd", "every 13th"."""
  ending = "th" if 10 <= stride % 100 <= 20 else {1: "st", 2: "nd", 3: "rd"}.get(stride % 10, "th")
  return f"every {stride}{ending}"


def _run(run: Run, stride: int, apart: int) -> dict[str, Any]:
  clocks: list[dict[str, str]] = []
  panels = []
  for panel in run.panels:
    lines = []
    for item in panel.lines:
      kept = _kept(item, stride)
      clock = packed(item.time[kept])
      if clock not in clocks:
        clocks.append(clock)
      lines.append({"who": item.who, "label": item.label or item.who, "clock": clocks.index(clock),
                    "value": packed(item.value[kept]), "dots": item.dots,
                    "spread": None if item.spread is None else packed(item.spread[kept])})  # fmt: skip
    panels.append({"title": panel.title, "noise": panel.noise, "lines": lines})
  return {"name": run.name, "note": run.note, "clocks": clocks, "panels": panels,
          "shaded": [list(map(float, span)) for span in run.shaded],
          "route": _route(run.route, apart) if run.route else None}  # fmt: skip


def _kept(item: Line, stride: int) -> NDArray[np.int64]:
  """Every so many samples of a line, and all that make its gaps; all of a line of few."""
  if len(item.value) <= _FEW:
    return np.arange(len(item.value))
  regular = np.arange(len(item.value)) % stride == 0
  return np.flatnonzero(regular | (np.isnan(item.time) & (stride > 1)))


def _route(route: Route, apart: int) -> dict[str, Any]:
  kept = slice(None, None, apart)
  level = None if route.level is None else packed(_highest(route.level, apart))
  return {"t": packed(route.time[kept]), "x": packed(route.x[kept]), "y": packed(route.y[kept]), "level": level}


def _highest(level: Array, apart: int) -> Array:
  """The largest of every so many values, so that thinning hides no peak."""
  short = -len(level) % apart
  return np.concatenate([level, np.full(short, -np.inf)]).reshape(-1, apart).max(axis=1)
