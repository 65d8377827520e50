"""A page: one file, verdict first, nothing fetched, nothing unescaped."""

import base64
import html.parser
import json
import re

import numpy as np
import pytest

from qcar_twin.pages import Chart, Clip, Explorer, Line, Moment, Panel, Route, Run, Section, Table, bars, write_page
from qcar_twin.pages.charts import unpacked
from qcar_twin.pages.page import show


class Reader(html.parser.HTMLParser):
  """Tags with their attributes, ids, link targets, and the text in order."""

  def __init__(self):
    super().__init__()
    self.tags, self.ids, self.targets, self.text, self.open = [], [], [], [], []

  def handle_starttag(self, tag, attrs):
    named = dict(attrs)
    self.tags.append((tag, named))
    if tag not in ("meta", "img", "link"):
      self.open.append(tag)
    if "id" in named:
      self.ids.append(named["id"])
    if tag == "a":
      self.targets.append(named["href"])

  def handle_endtag(self, tag):
    assert self.open.pop() == tag

  def handle_data(self, data):
    if not {"style", "script", "noscript"} & set(self.open) and data.strip():
      self.text.append(data.strip())


def read(path):
  reader = Reader()
  reader.feed(path.read_text(encoding="utf-8"))
  assert reader.open == []
  return reader


def sample_chart():
  return bars("errors", ["speed", "yaw rate"], {"twin": [0.1, 0.2], "bicycle": [0.2, np.nan]}, "NRMSE")


def sample_explorer(name="run_1"):
  time = np.linspace(0.0, 4.0, 50)
  panel = Panel("speed [m/s]", [Line("measured", time, time), Line("twin", time, time + 0.1)], 0.05)
  route = Route(time, np.cos(time), np.sin(time), time)
  return Explorer("look", [Run(name, [panel], route)], [Moment(name, 1.0, 2.0, "worst")], level="evidence [nats/s]")


def test_verdict_comes_first_and_contents_lead_to_every_section(tmp_path):
  sections = [Section("Steps", "One.\n\nTwo."), Section("Steps"), Section("Überblick")]
  facts = [("error removed", "70 %")]
  path = write_page(tmp_path / "new" / "report.html", "Calibration", "It fits.", sections, "sample, seed 3", facts)
  reader = read(path)
  assert reader.text[:7] == [
    "Calibration", "Calibration", "light / dark", "sample, seed 3", "It fits.", "error removed", "70 %",
  ]  # fmt: skip
  assert len(set(reader.ids)) == 4  # of the sections and of the button for light and dark
  assert [target.lstrip("#") for target in reader.targets] == [i for i in reader.ids if i != "theme"]
  assert [named for tag, named in reader.tags if tag == "p"].count({}) == 2 + 1  # and what is said without a script


def test_nothing_is_fetched_and_all_is_inside(tmp_path):
  clip = Clip(b"film", "driven", b"still")
  path = write_page(tmp_path / "r.html", "T", "V", [Section("F", figures=[sample_chart(), sample_explorer(), clip])])
  reader = read(path)
  outside = [v for _, named in reader.tags for k, v in named.items() if k in ("src", "href") and v[:5] != "data:"]
  assert [v for v in outside if not v.startswith("#")] == []
  assert not [named for tag, named in reader.tags if tag == "script" and "src" in named]
  allowed = next(named["content"] for tag, named in reader.tags if named.get("http-equiv") == "Content-Security-Policy")
  assert "default-src 'none'" in allowed and "http" not in allowed and "connect-src" not in allowed
  film = next(named["src"] for tag, named in reader.tags if tag == "video")
  assert base64.b64decode(film.removeprefix("data:video/mp4;base64,")) == b"film"
  assert path.stat().st_size < 6e6


def test_plotly_is_there_once_and_only_where_something_is_drawn(tmp_path):
  drawn = write_page(tmp_path / "a.html", "T", "V", [Section("F", figures=[sample_chart(), sample_chart()])])
  told = write_page(tmp_path / "b.html", "T", "V", [Section("F", "Text.")])
  assert drawn.read_text(encoding="utf-8").count("plotly.js v") == 1
  assert told.stat().st_size < 40_000


def test_all_text_is_escaped(tmp_path):
  nasty = '<script>alert("x")</script> & "quoted"'
  table = Table(nasty, [nasty], [[nasty]])
  figures = [Chart(nasty, [{"name": nasty}], {}), sample_explorer(nasty), Clip(b"x", nasty)]
  section = Section(nasty, f"{nasty}\n* {nasty}", [table], figures)
  path = write_page(tmp_path / "r.html", nasty, nasty, [section, section], nasty, [(nasty, nasty)])
  text = path.read_text(encoding="utf-8")
  assert text.count("<script>alert") == 0
  reader = read(path)
  # head, heading, subtitle, verdict, a fact's two; contents, then what each section shows
  assert reader.text.count(nasty) == 6 + 2 + 2 * 8
  blocks = re.findall(r'<script type="application/json">(.*?)</script>', text)
  assert json.loads(blocks[0])["traces"] == [{"name": nasty}] and json.loads(blocks[1])["runs"][0]["name"] == nasty


def test_data_reach_the_page_as_they_were(tmp_path):
  path = write_page(tmp_path / "r.html", "T", "V", [Section("S", figures=[sample_explorer()])])
  data = json.loads(re.findall(r'json">(.*?)</script>', path.read_text(encoding="utf-8"))[0])
  run = data["runs"][0]
  assert len(run["clocks"]) == 1 and [ln["clock"] for ln in run["panels"][0]["lines"]] == [0, 0]
  np.testing.assert_allclose(unpacked(run["panels"][0]["lines"][1]["value"]), np.linspace(0.1, 4.1, 50), rtol=1e-6)
  assert data["moments"] == [{"run": 0, "start": 1.0, "end": 2.0, "text": "worst"}]


def test_a_long_table_is_folded_away_unless_it_is_to_be_seen(tmp_path):
  tables = [Table("short", ["a"], [[1]] * 16), Table("long", ["a"], [[1]] * 17),
            Table("in sight", ["a"], [[1]] * 17, unfolded=True)]  # fmt: skip
  reader = read(write_page(tmp_path / "r.html", "T", "V", [Section("S", tables=tables)]))
  assert [tag for tag, _ in reader.tags].count("details") == 1 and "long (17 rows)" in reader.text


def test_lists_and_paragraphs(tmp_path):
  text = "First line\nsame paragraph\n\nThen:\n* one\n* two"
  reader = read(write_page(tmp_path / "r.html", "T", "V", [Section("S", text)]))
  begin = reader.text.index("First line same paragraph")
  assert reader.text[begin:][:5] == ["First line same paragraph", "Then:", "one", "two", "Keys:"]
  assert [tag for tag, _ in reader.tags].count("li") == 2


@pytest.mark.parametrize(
  ("cell", "text"),
  [
    (None, "–"),
    (float("nan"), "–"),
    (True, "yes"),
    (False, "no"),
    (0.0123456, "0.01235"),
    (-1.5, "−1.5"),
    (3, "3"),
    (12345.0, "12345"),
    (80517.9, "80518"),
    (-3, "−3"),
    (1.23456789e9, "1.235e+09"),
    (float("inf"), "inf"),
    ("a-b", "a-b"),
  ],
)
def test_cells(cell, text):
  assert show(cell) == text


def test_a_row_of_the_wrong_length_is_named():
  with pytest.raises(ValueError, match="table 'Errors', row 1: 1 cells for 2 columns"):
    Table("Errors", ["a", "b"], [[1, 2], [3]])


def test_a_page_needs_a_verdict_and_a_failure_leaves_the_old_page(tmp_path):
  path = write_page(tmp_path / "r.html", "T", "V", [])
  before = path.read_bytes()
  with pytest.raises(ValueError, match="verdict"):
    write_page(path, "T", " ", [])
  with pytest.raises(TypeError, match="bytes"):
    write_page(path, "T", "V", [Section("S", figures=[Clip("no bytes", "c")])])  # type: ignore
  assert path.read_bytes() == before
  assert list(tmp_path.iterdir()) == [path]


def test_the_same_run_writes_the_same_bytes(tmp_path):
  figures = lambda: [sample_chart(), sample_explorer(), Clip(b"x", "c")]
  pages = [write_page(tmp_path / n, "T", "V", [Section("S", figures=figures())]).read_bytes() for n in "ab"]
  assert pages[0] == pages[1]
