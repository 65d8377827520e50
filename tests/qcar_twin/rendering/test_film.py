"""Scenes, films and videos; what needs OpenGL is skipped where there is none."""

import dataclasses
import subprocess
import sys

import imageio.v3 as imageio
import mujoco
import numpy as np
import pytest

from qcar_twin.paths import path_named
from qcar_twin.plant import SIGNALS, signal_index
from qcar_twin.rendering.clip import comparison_film
from qcar_twin.rendering.film import (
  CAMERAS,
  Film,
  Look,
  RenderingUnavailable,
  gl_context,
  signals_of,
  write_still,
  write_video,
)
from qcar_twin.rendering.scene import GHOST_PREFIX, Puppet, scene, settle_view
from qcar_twin.vehicle.vehicle import Vehicle

VEHICLE = Vehicle.load()
SMALL = Look(width=160, height=120)


@pytest.fixture(scope="module")
def opengl():
  try:
    gl_context(16, 16).free()
  except RenderingUnavailable as error:
    pytest.skip(str(error))


def row(x=0.0, y=0.0, yaw=0.0, steering=0.0, speed=0.0):
  out = np.zeros(len(SIGNALS))
  for name, value in (
    ("pose_x", x),
    ("pose_y", y),
    ("pose_yaw", yaw),
    ("steering_angle", steering),
    ("velocity_x", speed),
  ):
    out[signal_index(name)] = value
  return out


def along(path, steps=60, period=0.01, speed=0.5):
  """Signals of a car that slides along a path exactly."""
  point = path.at(speed * period * np.arange(steps))
  return np.stack([row(*values, 0.0, speed) for values in zip(point.x, point.y, point.yaw, strict=True)])


# -- scenes --------------------------------------------------------------------------------------


def test_a_posed_car_stands_on_the_floor_where_it_should_with_its_wheels_turned():
  model = scene(VEHICLE).compile()
  data = mujoco.MjData(model)
  Puppet(model, VEHICLE).pose(data.qpos, row(1.0, -2.0, 0.7, 0.2))
  settle_view(model, data)
  chassis = data.body("chassis")
  np.testing.assert_allclose(chassis.xpos, [1.0, -2.0, VEHICLE.cg_height], atol=1e-12)
  assert np.arctan2(chassis.xmat[3], chassis.xmat[0]) == pytest.approx(0.7)
  left, right = (data.joint(f"front_{side}_steering").qpos[0] for side in ("left", "right"))
  assert 0.5 * (left + right) == pytest.approx(0.2) and left > right
  for wheel in ("front_left", "rear_right"):
    assert data.geom(wheel).xpos[2] == pytest.approx(VEHICLE.wheel_radius)


def test_wheels_roll_the_way_the_car_goes():
  model = scene(VEHICLE).compile()
  data = mujoco.MjData(model)
  puppet = Puppet(model, VEHICLE)
  for _ in range(10):
    puppet.pose(data.qpos, row(speed=0.66), elapsed=0.01)
  assert data.joint("rear_left_spin").qpos[0] == pytest.approx(10 * 0.01 * 0.66 / VEHICLE.wheel_radius)


def test_ghost_is_a_second_translucent_car_that_moves_by_itself():
  model = scene(VEHICLE, ghost=True).compile()
  data = mujoco.MjData(model)
  Puppet(model, VEHICLE).pose(data.qpos, row(1.0))
  Puppet(model, VEHICLE, GHOST_PREFIX).pose(data.qpos, row(-1.0, 0.5))
  settle_view(model, data)
  assert data.body("chassis").xpos[0] == 1.0
  np.testing.assert_allclose(data.body(GHOST_PREFIX + "chassis").xpos[:2], [-1.0, 0.5])
  shown = [g for g in range(model.ngeom) if model.geom(g).name.startswith(GHOST_PREFIX + "look")]
  assert shown and all(0.0 < model.geom_rgba[g, 3] < 0.5 for g in shown)
  assert all(f"{GHOST_PREFIX}{camera}" not in [model.camera(c).name for c in range(model.ncam)] for camera in CAMERAS)


def test_path_is_drawn_where_it_runs_and_borders_where_they_stand():
  path = path_named("c")
  model = scene(VEHICLE, path).compile()
  capsules = model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
  drawn = model.geom_pos[capsules & (model.geom_bodyid == 0)]
  arc = path.nearest(drawn[:, 0], drawn[:, 1])
  point = path.at(arc)
  assert np.hypot(point.x - drawn[:, 0], point.y - drawn[:, 1]).max() < 2e-3
  assert np.ptp(arc) > 0.9 * path.length
  boxes = (model.geom_type == mujoco.mjtGeom.mjGEOM_BOX) & (model.geom_bodyid == 0)
  sides = sorted(y for lane in path.lanes for y in (lane.left, lane.right))
  np.testing.assert_allclose(sorted(model.geom_pos[boxes, 1]), sides)
  assert not np.any(model.geom_contype[boxes]) and not np.any(model.geom_conaffinity[boxes])


# -- pictures ------------------------------------------------------------------------------------


@pytest.mark.usefixtures("opengl")
def test_each_camera_sees_the_car_or_what_is_ahead_of_it():
  pictures = {}
  for camera in CAMERAS:
    film = Film(path_named("s"), VEHICLE, dataclasses.replace(SMALL, camera=camera))
    pictures[camera] = film.frame(row())
    moved = film.frame(row(yaw=0.5))
    film.close()
    assert pictures[camera].shape == (120, 160, 3) and pictures[camera].std() > 5.0
    assert np.abs(moved.astype(int) - pictures[camera]).mean() > 0.5
  blue = {name: np.mean(p[..., 2].astype(int) - p[..., 0] > 40) for name, p in pictures.items()}
  assert blue["chase"] > 0.01 and blue["top"] > 0.003


@pytest.mark.usefixtures("opengl")
def test_ghost_and_text_change_the_picture_where_they_are():
  film = Film(None, VEHICLE, SMALL, ghost=True)
  together = film.frame(row(), row())
  beside = film.frame(row(), row(y=0.25))
  written = film.frame(row(), row(), text="time 1.00 s")
  film.close()
  orange = (beside[..., 0].astype(int) - beside[..., 2] > 60).sum()
  assert orange > 50 and np.any(beside != together)
  changed = np.any(written != together, axis=-1)
  assert changed[:40, :90].any() and not changed[60:].any()


@pytest.mark.usefixtures("opengl")
def test_two_films_do_not_disturb_each_other():
  first = Film(None, VEHICLE, SMALL)
  before = first.frame(row())
  second = Film(path_named("o"), VEHICLE, SMALL)
  second.frame(row())
  np.testing.assert_array_equal(first.frame(row()), before)
  second.close()
  np.testing.assert_array_equal(first.frame(row()), before)
  first.close()
  first.close()


@pytest.mark.filterwarnings("ignore:Exception ignored:pytest.PytestUnraisableExceptionWarning")  # the reader's pipes
@pytest.mark.usefixtures("opengl")
def test_a_drive_becomes_a_video_of_its_length(tmp_path):
  path = path_named("s")
  film = Film(path, VEHICLE, dataclasses.replace(SMALL, fps=20))
  file = tmp_path / "deep" / "film.mp4"
  count = write_video(file, film.frames(along(path, 100)), 20)
  assert count == 20 and [f.name for f in file.parent.iterdir()] == ["film.mp4"]
  frames = imageio.imread(file, plugin="FFMPEG")
  assert frames.shape == (20, 120, 160, 3) and np.abs(frames[0].astype(int) - frames[-1]).mean() > 1.0
  write_still(tmp_path / "still.png", film.frame(along(path)[0]))
  assert imageio.imread(tmp_path / "still.png").shape == (120, 160, 3)
  film.close()


@pytest.mark.usefixtures("opengl")
def test_error_written_into_the_picture_is_the_cross_track_error():
  path = path_named("o")
  film = Film(path, VEHICLE, SMALL)
  signals = along(path, 300)
  yaw = signals[:, 2]
  signals[:, 0] -= 0.03 * np.sin(yaw)
  signals[:, 1] += 0.03 * np.cos(yaw)
  np.testing.assert_allclose(film.cross_track_errors(signals), 0.03, atol=1e-9)
  film.close()


def test_no_frames_is_an_error(tmp_path):
  with pytest.raises(ValueError, match="no frames"):
    write_video(tmp_path / "film.mp4", iter(()), 25)


def test_unknown_camera_names_the_nearest():
  with pytest.raises(ValueError, match="did you mean chase"):
    Look(camera="chas")


def test_missing_opengl_names_the_debian_packages(monkeypatch):
  import mujoco.egl

  def fail(*size):
    raise ImportError("Unable to load EGL library")

  monkeypatch.setenv("MUJOCO_GL", "egl")
  monkeypatch.setattr(mujoco.egl, "GLContext", fail)
  with pytest.raises(RenderingUnavailable, match="apt-get install libegl1 libegl-mesa0"):
    Film(None, VEHICLE, SMALL)


def test_recorded_channels_become_signals_with_substitutes():
  steps = np.arange(5.0)
  channels = {name: steps for name in ("pose_x", "pose_y", "pose_yaw", "speed", "steering_command")}
  signals = signals_of(channels)
  assert signals.shape == (5, len(SIGNALS))
  for name in ("pose_x", "velocity_x", "steering_angle"):
    np.testing.assert_array_equal(signals[:, signal_index(name)], steps)
  assert np.all(signals[:, signal_index("velocity_y")] == 0.0)
  with pytest.raises(KeyError, match="pose_yaw"):
    signals_of({"pose_x": steps, "pose_y": steps})


@pytest.mark.filterwarnings("ignore:Exception ignored:pytest.PytestUnraisableExceptionWarning")  # the reader's pipes
@pytest.mark.usefixtures("opengl")
def test_a_comparison_opens_where_the_two_part_and_shows_one_ghost_after_the_other(tmp_path):
  drive = along(path_named("o"), 60)
  late = np.concatenate([np.repeat(drive[:1], 20, axis=0), drive[:-20]])
  look = Look("chase", 160, 120, fps=10, shadows=False)
  film, still = comparison_film(drive, [("before", "#ff0000", late), ("after", "#0000ff", drive)], 0.01, VEHICLE, look)
  (tmp_path / "film.mp4").write_bytes(film)
  pictures = imageio.imread(tmp_path / "film.mp4", plugin="FFMPEG")
  assert len(pictures) == 10 + 2 * 6 and len(film) < 300_000
  assert imageio.imread(still, extension=".jpg").shape == (120, 160, 3)
  red = lambda picture: int(np.sum((picture[..., 0] > 150) & (picture[..., 1] < 110) & (picture[..., 2] < 110)))
  assert red(pictures[10 + 5]) > red(pictures[10 + 11]) + 20
  assert red(pictures[0]) > red(pictures[10]) + 20  # the second a film stands, and its start with both in one place


def test_a_script_that_closes_no_film_ends_without_a_word():
  script = "from qcar_twin.rendering.film import Film; film = Film(); other = Film(); print(film.look)"
  ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120.0, check=False)
  assert (ended.returncode, ended.stderr) == (0, "")
