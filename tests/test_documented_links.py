"""Links between the pages lead somewhere: files exist, and so do the headings that are named."""

import re
from pathlib import Path

import pytest

from tests import ROOT

PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"\]\((?!https?:)([^)\s]+)\)")


def anchors(page: Path) -> set[str]:
  """What a page's headings are called in a link."""
  headings = re.findall(r"(?m)^#+ (.+)$", re.sub(r"(?ms)^```.*?^```", "", page.read_text(encoding="utf-8")))
  plain = (re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading) for heading in headings)
  return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
  text = re.sub(r"(?ms)^```.*?^```", "", page.read_text(encoding="utf-8"))
  for target in LINK.findall(text):
    name, _, heading = target.partition("#")
    there = (page.parent / name).resolve() if name else page
    assert there.exists(), f"{target}: no such file"
    if heading and there.suffix == ".md":
      assert heading in anchors(there), f"{target}: no such heading"


def test_every_page_is_in_the_index():
  index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
  for page in (*(ROOT / "docs" / "guide").glob("*.md"), *(ROOT / "docs" / "reference").glob("*.md")):
    assert f"({page.parent.name}/{page.name})" in index, page.name
