"""The page of the catalogue: complete, current, and written whole."""

import re

from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.mechanisms.document import page, sections, write
from tests import ROOT

PAGE = ROOT / "docs" / "reference" / "mechanisms.md"


def test_page_in_the_repository_is_current():
  assert PAGE.read_text(encoding="utf-8") == page(), (
    "run python -m qcar_twin.twin.mechanisms.document docs/reference/mechanisms.md"
  )


def test_every_mechanism_and_parameter_is_on_the_page():
  text = page()
  for mechanism in catalogue().values():
    assert f"\n### {mechanism.name}\n" in text
    assert all(f"`{p.name}`" in text and p.description in text for p in mechanism.parameters)
    assert sections(mechanism)["Source"] in text


def test_the_readme_counts_what_a_diagnosis_can_name():
  (count,) = re.findall(r"a catalogue of (\d+) mechanisms", (ROOT / "README.md").read_text(encoding="utf-8"))
  assert int(count) == sum(not m.curve for m in catalogue().values())


def test_sections_are_single_lines_without_the_docstring_indent():
  parts = sections(catalogue()["steering_lag"])
  assert list(parts) == ["Summary", "Equation", "Units", "Source", "Size", "Confounded with"]
  assert all("\n" not in body and "  " not in body for body in parts.values())


def test_page_is_written_whole(tmp_path):
  write(tmp_path / "new" / "page.md")
  assert [p.name for p in (tmp_path / "new").iterdir()] == ["page.md"]
  assert (tmp_path / "new" / "page.md").read_text(encoding="utf-8") == page()
