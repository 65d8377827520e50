"""A table reads back, through an independent Markdown parser, as what was put in."""

import re

import markdown as parser
import pytest

from qcar_twin.markdown import table


def test_a_table_reads_back():
  rows = [("speed", "0.1", ""), ("a|b", "-", "x y")]
  page = parser.markdown("\n".join(table(("what", "", "note"), rows)), extensions=["tables"])
  read = [re.findall(r"<t[hd]>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>(.*?)</tr>", page, re.DOTALL)]
  assert read == [["what", "", "note"], *map(list, rows)]


def test_a_row_of_another_width_is_refused():
  with pytest.raises(ValueError, match="row 1 of the table 'a': 1 cells for 2 titles"):
    table(("a", "b"), [("1", "2"), ("3",)])
