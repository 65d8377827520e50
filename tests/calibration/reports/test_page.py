"""The report: one file, verdict first, nothing fetched, nothing unescaped."""

import base64
import html.parser
import re

import numpy as np
import pytest
from calibration.reports.page import show

from calibration.reports import Picture, Section, Table, picture, write_page
from qcar_twin import plotting


class Reader(html.parser.HTMLParser):
  """Tags with their attributes, ids, link targets, and the text in order."""

  def __init__(self):
    super().__init__()
    self.tags, self.ids, self.targets, self.text, self.open = [], [], [], [], []

  def handle_starttag(self, tag, attrs):
    named = dict(attrs)
    self.tags.append((tag, named))
    if tag not in ("meta", "img"):
      self.open.append(tag)
    if "id" in named:
      self.ids.append(named["id"])
    if tag == "a":
      self.targets.append(named["href"])

  def handle_endtag(self, tag):
    assert self.open.pop() == tag

  def handle_data(self, data):
    if "style" not in self.open and data.strip():
      self.text.append(data.strip())


def read(path):
  reader = Reader()
  reader.feed(path.read_text(encoding="utf-8"))
  assert reader.open == []
  return reader


def sample_picture():
  figure, axes = plotting.new_figure(2, 1, share_x=True)
  time = np.linspace(0.0, 1.0, 20)
  for who in ("measured", "twin", "bicycle", "before"):
    plotting.draw(axes[0, 0], time, time, who)
  plotting.shade_noise(axes[1, 0], 0.1)
  plotting.bars(axes[1, 0], ["speed", "yaw rate"], {"twin": [0.1, 0.2], "bicycle": [0.2, np.nan]})
  return figure


def test_verdict_comes_first_and_contents_lead_to_every_section(tmp_path):
  sections = [Section("Steps", "One.\n\nTwo."), Section("Steps"), Section("Überblick")]
  reader = read(write_page(tmp_path / "new" / "report.html", "Calibration", "It fits.", sections, "sample, seed 3"))
  assert reader.text[:4] == ["Calibration", "Calibration", "sample, seed 3", "It fits."]
  assert len(set(reader.ids)) == 3
  assert [target.lstrip("#") for target in reader.targets] == reader.ids
  assert [named for tag, named in reader.tags if tag == "p"].count({}) == 2


def test_nothing_is_fetched_and_pictures_are_inside(tmp_path):
  figures = [picture(sample_picture(), "drawn", kind) for kind in ("png", "svg")]
  path = write_page(tmp_path / "r.html", "T", "V", [Section("Figures", figures=figures)])
  reader = read(path)
  sources = [named["src"] for tag, named in reader.tags if tag == "img"]
  assert [re.match(r"data:image/([a-z+]+);base64,", s).group(1) for s in sources] == ["png", "svg+xml"]  # type: ignore
  assert base64.b64decode(sources[0].split(",")[1]).startswith(b"\x89PNG")
  assert b"<svg" in base64.b64decode(sources[1].split(",")[1])
  outside = [v for _, named in reader.tags for k, v in named.items() if k in ("src", "href") and v[:1] not in "#d"]
  assert outside == []
  assert not {tag for tag, _ in reader.tags} & {"script", "link", "iframe"}
  assert "url(" not in path.read_text(encoding="utf-8") and "@import" not in path.read_text(encoding="utf-8")


def test_all_text_is_escaped(tmp_path):
  nasty = '<script>alert("x")</script> & "quoted"'
  table = Table(nasty, [nasty], [[nasty]])
  section = Section(nasty, f"{nasty}\n* {nasty}", [table], [Picture(b"x", nasty)])
  reader = read(write_page(tmp_path / "r.html", nasty, nasty, [section, section], nasty))
  assert "script" not in {tag for tag, _ in reader.tags}
  assert reader.text.count(nasty) == 4 + 2 + 2 * 7  # head, contents, and what each section shows


def test_lists_and_paragraphs(tmp_path):
  text = "First line\nsame paragraph\n\nThen:\n* one\n* two"
  reader = read(write_page(tmp_path / "r.html", "T", "V", [Section("S", text)]))
  assert reader.text[-4:] == ["First line same paragraph", "Then:", "one", "two"]
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
  with pytest.raises(Exception, match="decode|attribute|bytes"):
    write_page(path, "T", "V", [Section("S", figures=[Picture("no bytes", "c")])])  # type: ignore
  assert path.read_bytes() == before
  assert list(tmp_path.iterdir()) == [path]


def test_the_same_run_writes_the_same_bytes(tmp_path):
  pages = []
  for name in ("a.html", "b.html"):
    figures = [picture(sample_picture(), "c", kind) for kind in ("png", "svg")]
    pages.append(write_page(tmp_path / name, "T", "V", [Section("S", figures=figures)]).read_bytes())
  assert pages[0] == pages[1]
