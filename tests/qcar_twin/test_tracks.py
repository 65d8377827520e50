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
    ("0,0,0\n1,1,0\n2,2,0\n3,3,0\n", "has 3 columns and no names for them; give a line of names with x and y"),
    ("lon,lat\n8.1,48.1\n8.2,48.1\n", "its columns are lon, lat, of which not one is x and one y"),
    ("x [deg],y [deg]\n8.1,48.1\n8.2,48.1\n", "x and y are in deg; a path is in m"),
    ("0,0\n26,0\n52,9\n70,20\n", "neighbouring points are 26 m apart; name the unit"),
    ("4.5e5,5.4e6\n450001,5.4e6\n450002,5.4e6\n450003,5.4e6\n", "take its first point off all points"),
  ],
)
def test_what_is_no_path_is_refused_with_its_row(tmp_path, text, said):
  file = tmp_path / "points.csv"
  file.write_text(text, encoding="utf-8")
  with pytest.raises(ValueError, match=said):
    path_from(str(file))


@pytest.mark.parametrize(
  ("header", "row"),
  [
    ("y,x", lambda x, y: f"{y:.9f},{x:.9f}"),
    ("t,x [cm],y [cm]", lambda x, y: f"0.1,{100 * x:.7f},{100 * y:.7f}"),
    ("x_mm;y_mm", lambda x, y: f"{1000 * x:.6f};{1000 * y:.6f}"),
    ("# s_m; x_m; y_m; psi_rad", lambda x, y: f"0.0; {x:.9f}; {y:.9f}; 0.0"),
    ("x y", lambda x, y: f"{x:.9f} {y:.9f}"),
  ],
)
def test_columns_go_by_their_names_and_units(tmp_path, header, row):
  o = path_named("o")
  file = tmp_path / "line.csv"
  lines = [header, *(row(x, y) for x, y in zip(o.x[::20], o.y[::20], strict=True)), row(o.x[0], o.y[0])]
  file.write_text("\n".join(lines) + "\n", encoding="utf-8")
  assert path_from(str(file)).length == pytest.approx(o.length, abs=1e-4)


def test_a_turn_that_the_car_cannot_take_is_said(tmp_path, caplog):
  file = tmp_path / "corner.csv"
  file.write_text("x,y\n0,0\n0.5,0\n1,0\n1,0.05\n0.5,0.05\n0,0.05\n", encoding="utf-8")
  path_from(str(file))
  assert "where the QCar's tightest is 0.44 m; it will leave the path" in caplog.text


def test_names_there_are_not_are_refused_with_the_nearest():
  with pytest.raises(KeyError, match="did you mean infinity"):
    path_from("infinty")
  for name in ("random", "random:x", "random:-1", "random:1:0.5"):
    with pytest.raises(ValueError, match="random"):
      path_from(name)
  with pytest.raises(FileNotFoundError):
    path_from("nowhere.csv")
