"""Recordings whose files are called alike have names that tell them apart."""

import dataclasses

import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.parts.called import told_apart
from qcar_twin.recordings.first_dataset.roles import Part
from scripts import new
from tests.qcar_twin.recordings.drives import drive, write_csv


def named(*files, **more):
  return [part.name for part in told_apart([Part(file, "identify", **more) for file in files])]


@pytest.mark.parametrize(
  ("files", "names"),
  [
    (("a.csv", "b.csv"), ["", ""]),
    (("tub_1/catalog.csv", "tub_2/catalog.csv", "other.csv"), ["tub_1", "tub_2", ""]),
    (("day/1/log/x.csv", "day/2/log/x.csv"), ["1", "2"]),
    (("x.csv", "more/x.csv"), ["x.csv", "more_x.csv"]),
    (("x.csv", "x.tsv"), ["x.csv", "x.tsv"]),
    (("a/x.csv", "b/x.csv", "a.csv"), ["a_x.csv", "b_x.csv", "a.csv"]),
  ],
)
def test_a_name_is_what_differs(files, names):
  assert named(*files) == names


def test_parts_of_files_keep_what_tells_them_apart():
  parts = [Part(f"{folder}/x.csv", "identify", begin=begin) for folder in "ab" for begin in (None, 12.0)]
  parts.append(dataclasses.replace(parts[0], begin=30.0, name="x_3"))
  assert [part.name for part in told_apart(parts)] == ["a", "a_12s", "b", "b_12s", "a_3"]


def test_what_new_writes_of_files_that_are_called_alike_is_read(tmp_path):
  for number in (1, 2):
    time, own = drive(14.0, seed=number)
    (tmp_path / "logs" / f"tub_{number}").mkdir(parents=True)
    write_csv(tmp_path / "logs" / f"tub_{number}" / "catalog_0.csv", time, own)
  new.main(new.Config(tmp_path / "lab", (tmp_path / "logs",), wheelbase=0.256, mass=2.7))
  data = DataSet.load(tmp_path / "lab")
  assert {(run.name, run.file) for run in data.recordings} == {(f"tub_{k}", f"tub_{k}/catalog_0.csv") for k in (1, 2)}
