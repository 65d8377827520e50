"""A file is there as a whole, or what was there before is."""

import json
from pathlib import Path

import numpy as np
import pytest

from qcar_twin.atomic_io import plain, whole_file, whole_folder, write_json, write_text


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_what_stops_the_writer_leaves_what_was_there(tmp_path, error):
  file = write_text(tmp_path / "page.md", "old")
  with pytest.raises(error), whole_file(file) as part:
    part.write_text("half of the n")
    raise error
  assert file.read_text() == "old" and [p.name for p in tmp_path.iterdir()] == ["page.md"]


def test_nothing_is_left_of_a_new_file_that_failed(tmp_path):
  with pytest.raises(TypeError):
    write_text(tmp_path / "deep" / "page.md", 5)  # type: ignore[arg-type]
  assert not list((tmp_path / "deep").iterdir())


def test_a_block_that_writes_nothing_is_an_error_and_loses_nothing(tmp_path):
  file = write_text(tmp_path / "page.md", "old")
  with pytest.raises(FileNotFoundError), whole_file(file):
    pass
  assert file.read_text() == "old"


def test_a_folder_that_cannot_take_its_place_leaves_the_one_that_was_there(tmp_path, monkeypatch):
  place, rename = tmp_path / "kept", Path.rename
  write_text(place / "a.txt", "old")

  def refused(path, target):
    if Path(target) == place and (path / "b.txt").exists():
      raise PermissionError("in use")
    return rename(path, target)

  monkeypatch.setattr(Path, "rename", refused)
  with pytest.raises(PermissionError), whole_folder(place) as part:
    (part / "b.txt").write_text("new")
  assert (place / "a.txt").read_text() == "old" and not (place / "b.txt").exists()


def test_until_the_end_no_listing_finds_the_part_and_readers_see_the_old_file(tmp_path):
  file = write_text(tmp_path / "a_run.json", "old")
  with whole_file(file) as part:
    part.write_text("new")
    assert part.name == file.name
    assert list(tmp_path.glob("*.json")) == [file] and file.read_text() == "old"
  assert file.read_text() == "new"


def test_the_folder_is_made_and_the_file_has_ordinary_rights(tmp_path):
  file = write_text(tmp_path / "one" / "two" / "a.txt", "ü\r\n")
  plainly = tmp_path / "plainly.txt"
  plainly.write_text("")
  assert file.read_bytes() == "ü\r\n".encode() and file.stat().st_mode == plainly.stat().st_mode


def test_json_of_numpy_and_of_what_is_not_finite(tmp_path):
  data = {"a": np.array([[1.5, np.nan]]), 2: (np.int64(3), np.bool_(True), float("inf")), "c": None, "d": Path("µ")}
  assert json.loads(write_json(tmp_path / "a.json", data).read_text("utf-8")) == {
    "a": [[1.5, None]],
    "2": [3, True, None],
    "c": None,
    "d": "µ",
  }
  assert [type(v) for v in plain(data)["2"][:2]] == [int, bool]
