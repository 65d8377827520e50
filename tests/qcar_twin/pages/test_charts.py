"""Charts are what plotly takes, colours come from the house's table, and thinning keeps gaps and peaks."""

import re

import numpy as np
import pytest

from qcar_twin.pages import Explorer, Line, Moment, Panel, Route, Run, bars, heat_map, line, panels, ranked
from qcar_twin.pages.charts import packed, unpacked
from qcar_twin.pages.explorer import ordinal
from qcar_twin.plotting import PALETTE

T = np.linspace(0.0, 10.0, 101)
CHARTS = {
  "bars": bars("c", ["a", "b"], {"before": [2.0, 3.0], "twin": [1.0, np.nan]}, "error", {"twin": ([0.5, 0.5], [2, 2])},
               (1.0, "noise")),
  "ranked": ranked("c", [("one", 10.0, "twin", False), ("two", -3.0, "nominal", True)], "nats"),
  "heat_map": heat_map("c", ["0–1", "1–2"], ["low"], [[1.0, np.nan]], ("speed", "side", "%"), (0.0, 50.0)),
  "panels": panels("c", [("left", "y", [line(T, T, "twin")]), ("right", "y", [line(T, -T, "twin")])], ["x", "z"]),
}  # fmt: skip


def resolved(value):
  """What the page's script makes of colours by name."""
  if isinstance(value, str):
    return "Blues" if value == "@heat" else re.sub(r"^@[a-z]+(/.*)?$", "#123456", value)
  if isinstance(value, (list, tuple)):
    return [resolved(item) for item in value]
  return {k: resolved(v) for k, v in value.items()} if isinstance(value, dict) else value


def names(value):
  if isinstance(value, str):
    return set(re.findall(r"^@([a-z]+)", value))
  items = value.values() if isinstance(value, dict) else value if isinstance(value, (list, tuple)) else ()
  return set().union(*map(names, items))


@pytest.mark.parametrize("kind", CHARTS)
def test_plotly_takes_every_chart(kind):
  graph_objects = pytest.importorskip("plotly.graph_objects")
  data = CHARTS[kind].data()
  figure = graph_objects.Figure(resolved(data["traces"]), resolved(data["layout"]))
  assert len(figure.data) == len(data["traces"]) > 0


@pytest.mark.parametrize("kind", CHARTS)
def test_colours_are_the_houses(kind):
  used = names(CHARTS[kind].data())
  assert used and used <= set(PALETTE) | {"heat"}


def test_what_is_not_finite_is_left_out():
  assert CHARTS["bars"].data()["traces"][1]["y"] == [1.0, None]
  assert CHARTS["heat_map"].data()["traces"][0]["text"] == [["1", ""]]
  assert CHARTS["ranked"].data()["traces"][0]["x"] == [10.0, 0.0]


def test_a_name_is_in_the_legend_once():
  assert [t["showlegend"] for t in CHARTS["panels"].data()["traces"]] == [True, False]


def test_numbers_travel_in_seven_digits_and_late_times_in_all():
  values = np.array([1.0, -2.5, np.nan, np.inf, 123.456])
  np.testing.assert_allclose(unpacked(packed(values)), [1.0, -2.5, np.nan, np.nan, 123.456], rtol=1e-7)
  late = 1.7e9 + T
  assert packed(values)["dtype"] == "f4" and packed(late)["dtype"] == "f8"
  np.testing.assert_array_equal(unpacked(packed(late)), late)


def test_thinning_is_told_and_keeps_gaps():
  time = np.where(np.arange(1000) == 501, np.nan, np.arange(1000.0))
  lines = [Line("measured", time, time), Line("twin", time, time)]
  explorer = Explorer("Seen.", [Run("a", [Panel("speed [m/s]", lines)])], room=500)
  assert (
    explorer.stride == 4 and explorer.full_caption == "Seen. Drawn is every 4th sample of long lines; tables use all."
  )
  panel = explorer.data()["runs"][0]["panels"][0]
  kept = unpacked(explorer.data()["runs"][0]["clocks"][0])
  assert len(kept) == 251 and np.isnan(kept).sum() == 1 and len(panel["lines"]) == 2
  whole = Explorer("Seen.", [Run("a", [Panel("speed [m/s]", lines)])])
  assert whole.stride == 1 and whole.full_caption == "Seen."


def test_the_map_keeps_its_highest_place():
  level = np.zeros(9001)
  level[4567] = 7.0
  long = np.arange(9001.0)
  data = Explorer("c", [Run("a", [], Route(long, long, long, level))], level="e").data()["runs"][0]["route"]
  assert len(unpacked(data["level"])) == len(unpacked(data["t"])) <= 4001
  assert unpacked(data["level"]).max() == 7.0


def test_moments_of_runs_that_are_not_shown_are_left_out():
  explorer = Explorer("c", [Run("a", [])], [Moment("b", 0.0, 1.0), Moment("a", 2.0, 3.0, "why")])
  assert explorer.data()["moments"] == [{"run": 0, "start": 2.0, "end": 3.0, "text": "why"}]


def test_ordinals():
  assert [ordinal(k) for k in (2, 3, 4, 11, 21, 112)] == [
    "every 2nd", "every 3rd", "every 4th", "every 11th", "every 21st", "every 112th",
  ]  # fmt: skip
