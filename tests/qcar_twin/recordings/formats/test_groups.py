"""Thousands in groups: by a dot beside decimal commas, by a comma beside decimal points, by apostrophes and spaces."""

import numpy as np
import pytest

from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError

RPM = np.array([870.0, 3214.0, -12050.0, 1003214.0] * 10)
GERMAN = ["870", "3.214", "-12.050", "1.003.214"] * 10


def read(tmp_path, cells, decimal=",", separator=";", times=None):
  """A table of a clock with that mark of decimals and a column of cells."""
  stamps = [f"{k / 50:.2f}".replace(".", decimal) for k in range(len(cells))] if times is None else times
  quoted = '"{}"' if separator == "," else "{}"
  lines = ["Zeit [s];Motordrehzahl [1/min]".replace(";", separator)]
  lines += [separator.join(quoted.format(cell) for cell in row) for row in zip(stamps, cells, strict=True)]
  (tmp_path / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
  return read_table(tmp_path / "log.csv")


def motor(table):
  return table.number("Motordrehzahl [1/min]", "motor_speed")


@pytest.mark.parametrize("separator", [";", ",", "\t"])
@pytest.mark.parametrize("mark", [".", "'", "\u2019", "\u00a0", "\u2009", "\u202f", " "])
def test_beside_decimal_commas(tmp_path, separator, mark):
  np.testing.assert_array_equal(motor(read(tmp_path, [c.replace(".", mark) for c in GERMAN], ",", separator)), RPM)


@pytest.mark.parametrize("separator", [";", ",", "\t"])
@pytest.mark.parametrize("mark", [",", "'", "\u202f"])
def test_beside_decimal_points(tmp_path, separator, mark):
  cells = [c.replace(".", mark) for c in GERMAN]
  np.testing.assert_array_equal(motor(read(tmp_path, cells, ".", separator)), RPM)


def test_with_decimals_of_their_own_and_blank_cells(tmp_path):
  values = motor(read(tmp_path, ["3.214,5", "", "870,25", "0,5", "12"] * 8))
  np.testing.assert_array_equal(values, [3214.5, np.nan, 870.25, 0.5, 12.0] * 8)
  values = motor(read(tmp_path, ["1,234.5", "", "870.25", "0.5", "12"] * 8, ".", ","))
  np.testing.assert_array_equal(values, [1234.5, np.nan, 870.25, 0.5, 12.0] * 8)


def test_a_first_row_of_groups_alone_does_not_make_commas_decimal(tmp_path):
  values = motor(read(tmp_path, ["1,234", "870", "12.5", "2,500"] * 10, ".", ";", [str(k) for k in range(40)]))
  np.testing.assert_array_equal(values, [1234.0, 870.0, 12.5, 2500.0] * 10)


def test_decimal_commas_that_come_late(tmp_path):
  cells = ["0"] * 20 + ["0,5"] * 20
  np.testing.assert_array_equal(
    motor(read(tmp_path, cells, times=[str(k) for k in range(40)])), [0.0] * 20 + [0.5] * 20
  )


@pytest.mark.parametrize("wrong", ["3.21", "12.5", "0.870", "3.2145", "3.214.5"])
def test_a_dot_that_parts_no_groups_is_an_error(tmp_path, wrong):
  said = rf"log\.csv: column 'Motordrehzahl \[1/min\]' has '{wrong}' in row 3: .* comma before .* without groups"
  with pytest.raises(RecordingError, match=said):
    read(tmp_path, ["870", "3.214", wrong, "4.100"] * 10)


def test_a_comma_that_parts_no_groups_is_an_error(tmp_path):
  with pytest.raises(RecordingError, match=r"has '12,5' in row 2: .* dot before .* 3,214\.5"):
    read(tmp_path, ["1,234.5", "12,5"] * 20, ".", ",")


def test_where_nothing_tells_a_dot_is_a_decimal_point(tmp_path):
  values = motor(read(tmp_path, ["870", "3.214"] * 20, times=[str(k) for k in range(40)]))
  np.testing.assert_array_equal(values, [870.0, 3.214] * 20)


def test_a_column_of_another_tool_has_its_own_decimal_points(tmp_path):
  """None of its dots parts groups."""
  np.testing.assert_array_equal(motor(read(tmp_path, ["52.51", "52.5", "0"] * 10)), [52.51, 52.5, 0.0] * 10)


@pytest.mark.parametrize("cell", ["01.03.2026", "1.2.3", "run 1.234"])
def test_dates_versions_and_words_are_no_numbers(tmp_path, cell):
  table = read(tmp_path, [cell] * 30)
  assert "Motordrehzahl [1/min]" in table.columns
