"""Rows with another number of cells than the header are named by their number below it."""

import pytest

from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError

FITS = "a row does not fit the header: "


@pytest.mark.parametrize(
  ("text", "texts"),
  [
    (
      "time,speed\n0,1\n1,2,3\n",
      [f"{FITS}row 2 has 3 cells where the header has 2 ('1,2,3'); repair or delete that row"],
    ),
    (
      "time,speed\n0,1\n1,2,3\n2,2\n3\n4,\n",
      [
        "row 2 has 3 cells",
        "1 more does not fit either; repair or delete those rows",
      ],
    ),
    (
      "time,speed,yaw_rate\n0,1,2\n1,2",
      ["row 2 has 2 cells where the header has 3", "cut off when a logger is killed"],
    ),
    ("time,a,b\n0,1,2\n\n1\n", ["row 2 has 1 cell where"]),
    ("# by hand\ntime,a,b\n0,1,2\n# a remark\n1,2\n", ["row 2 has 2 cells"]),
    ("Logger 3\nCar 7\n\ntime,a,b\n" + "0,1,2\n" * 40 + "2,1\n", ["row 41 has 2 cells"]),
    ("time a b\n0.0 1 2\n0.1 1\n0.2 1 2\n", ["row 2 has 2 cells", "('0.1 1')"]),
  ],
)
def test_a_torn_row_is_named(tmp_path, text, texts):
  (tmp_path / "run.csv").write_text(text, encoding="utf-8")
  with pytest.raises(RecordingError) as caught:
    read_table(tmp_path / "run.csv")
  assert str(caught.value).startswith("run.csv: ")
  for said in texts:
    assert said in str(caught.value)
