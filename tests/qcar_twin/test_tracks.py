"""Paths by name: random tracks, points in a CSV file, and what is refused."""

import numpy as np
import pytest

from qcar_twin.paths import path_named
from qcar_twin.tracks import TIGHTEST, path_from


def test_a_random_track_is_its_seeds_smooth_and_no_tighter_than_the_training_path():
  one, again, other = path_from("random:3"), path_from("random:3"), path_from("random:4")
  np.testing.assert_array_equal(one.x, again.x)
  assert len(one.x) != len(other.x) or not np.array_equal(one.x, other.x)
  for seed in range(20):
    path = path_from(f"random:{seed}:20")
    assert 19.0 <= path.length <= 30.0 and np.abs(path.curvature).max() <= TIGHTEST + 1e-9
    assert np.abs(np.diff(path.curvature)).max() < 0.05
    np.testing.assert_allclose(np.hypot(np.diff(path.x), np.diff(path.y)), path.arc_length[1], rtol=1e-3)


def points(tmp_path, every=20, header=""):
  o = path_named("o")
  rows = np.stack([o.x, o.y], axis=-1)[::every]
  rows = np.concatenate([rows, rows[:1]])
  file = tmp_path / "oval.csv"
  file.write_text(header + "\n".join(f"{x:.9f},{y:.9f}" for x, y in rows) + "\n", encoding="utf-8")
  return file


@pytest.mark.parametrize("header", ["", "x,y\n", "# metres\nx,y\n"])
def test_points_of_a_path_give_it_back(tmp_path, header):
  path, o = path_from(str(points(tmp_path, header=header))), path_named("o")
  assert path.closed and path.name == "oval" and path.length == pytest.approx(o.length, abs=1e-4)
  s = np.linspace(0.0, o.length, 200)
  back, true = path.at(s), o.at(s)
  np.testing.assert_allclose(back.x, true.x, atol=1e-4)
  np.testing.assert_allclose(back.yaw, true.yaw, atol=3e-3)
  np.testing.assert_allclose(back.curvature, true.curvature, atol=0.1)


@pytest.mark.parametrize(
  "text, said",
  [
    ("0,0\n1,0\n2,0\n", "3 points; a path needs at least four"),
    ("0,0\n1,0\nabc\n3,0\n", "row 3 is not x, y in m: 'abc'"),
    ("0,0\n1,0\nnan,0\n3,0\n", "row 3 is not finite"),
    ("0,0\n1,0\n1,0\n3,0\n", "row 3 repeats the point before it"),
  ],
)
def test_what_is_no_path_is_refused_with_its_row(tmp_path, text, said):
  file = tmp_path / "points.csv"
  file.write_text(text, encoding="utf-8")
  with pytest.raises(ValueError, match=said):
    path_from(str(file))


def test_names_there_are_not_are_refused_with_the_nearest():
  with pytest.raises(KeyError, match="did you mean infinity"):
    path_from("infinty")
  for name in ("random", "random:x", "random:-1", "random:1:0.5"):
    with pytest.raises(ValueError, match="random"):
      path_from(name)
  with pytest.raises(FileNotFoundError):
    path_from("nowhere.csv")
