"""Pictures and videos without a screen: chase, top and onboard cameras, a ghost car, text over the picture.

OpenGL comes from EGL (or OSMesa with MUJOCO_GL=osmesa), video from the ffmpeg that imageio-ffmpeg brings along.
"""

import atexit
import contextlib
import dataclasses
import difflib
import errno
import itertools
import os
import weakref
from collections.abc import Iterator
from pathlib import Path as File
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from qcar_twin.atomic_io import whole_file
from qcar_twin.extras import extra
from qcar_twin.paths import Path
from qcar_twin.plant import POSE, SIGNALS, VELOCITY, YAW_RATE
from qcar_twin.rendering.scene import GHOST_PREFIX, Puppet, scene, settle_view
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
FILMS = (".mp4", ".mov", ".mkv")
CAMERAS = ("chase", "top", "onboard")
PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri libglvnd0"


_OPENED: list[int] = []  # process that opened OpenGL first; a forked one inherits the entry


class RenderingUnavailable(RuntimeError):
  """There is no OpenGL to render with; the message names what to install."""


def gl_context(width: int, height: int) -> Any:
  """An OpenGL context without a window.

  Raises:
    RenderingUnavailable: the system has none, with the Debian packages that bring it.
  """
  kind = os.environ.get("MUJOCO_GL", "egl").lower() or "egl"
  _OPENED.append(os.getpid())
  if _OPENED[0] != os.getpid():  # its driver's threads stayed behind: it would wait for them for ever
    raise RenderingUnavailable(
      "OpenGL was opened before this process was forked; start processes by 'spawn' or 'forkserver', or render in one"
    )
  try:
    if kind == "osmesa":
      from mujoco.osmesa import GLContext
    else:
      from mujoco.egl import GLContext
    context = GLContext(width, height)
    context.make_current()
  except Exception as error:  # PyOpenGL raises whatever its loader meets
    raise RenderingUnavailable(
      f"no OpenGL through {kind} ({type(error).__name__}: {error}); on Debian: apt-get install {PACKAGES}, or"
      " libosmesa6 with MUJOCO_GL=osmesa"
    ) from error
  return context


@dataclasses.dataclass(frozen=True)
class Look:
  """How a film looks.

  Attributes:
    camera: one of CAMERAS.  width, height: pixels.  fps: frames per second of driving.
    shadows, reflections: prettier and slower.
  """

  camera: str = "chase"
  width: int = 640
  height: int = 480
  fps: int = 25
  shadows: bool = True
  reflections: bool = False

  def __post_init__(self) -> None:
    if self.camera not in CAMERAS:
      near = difflib.get_close_matches(self.camera, CAMERAS, n=1) or list(CAMERAS)
      raise ValueError(f"no camera '{self.camera}'; did you mean {', '.join(near)}?")


class Film:
  """A camera on one car, or on two of which the second is translucent.

  Args:
    path: drawn on the floor, with its borders; None for a bare floor.
    vehicle: both cars; the QCar without it.
    look: picture settings.
    ghost: whether there is a second car.
  """

  def __init__(
    self, path: Path | None = None, vehicle: Vehicle | None = None, look: Look = Look(), ghost: bool = False
  ):
    self._context: Any = None
    vehicle = vehicle or Vehicle.load()
    self.look, self.path = look, path
    spec = scene(vehicle, path, ghost)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = look.width, look.height
    self._model = spec.compile()
    self._data = mujoco.MjData(self._model)
    self._puppets = [Puppet(self._model, vehicle)] + ([Puppet(self._model, vehicle, GHOST_PREFIX)] if ghost else [])
    self._context = gl_context(look.width, look.height)
    if not _OPEN:  # after EGL's own, so that it goes first: without a display no context can be given back
      atexit.unregister(_close_all)
      atexit.register(_close_all)
    _OPEN.add(self)
    self._drawing = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._drawing)
    self._scene = mujoco.MjvScene(self._model, maxgeom=2000)
    self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = look.shadows
    self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = look.reflections
    self._option, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
    self._option.geomgroup[3] = 0  # collision shapes
    self._option.sitegroup[:] = 0
    self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    self._camera.fixedcamid = self._model.camera(look.camera).id

  def paint_ghost(self, colour: tuple[float, float, float, float]) -> None:
    """Give the second car another colour, red, green, blue and opacity from 0 to 1."""
    for number in range(self._model.ngeom):
      geom = self._model.geom(number)
      if geom.name.startswith(GHOST_PREFIX) or self._model.body(geom.bodyid[0]).name.startswith(GHOST_PREFIX):
        if self._model.geom_group[number] == 2:
          self._model.geom_rgba[number] = colour

  def frame(self, signals: Array, ghost: Array | None = None, text: str = "", elapsed: float = 0.0) -> Picture:
    """One picture, (height, width, 3).

    Args:
      signals, ghost: rows of plant.SIGNALS, (10,).
      text: written into the upper left corner, lines separated by newlines; "name value" per line reads best.
      elapsed: s since the last frame, by which the wheels roll on.
    """
    cars = [signals] if len(self._puppets) == 1 else [signals, signals if ghost is None else ghost]
    for puppet, row in zip(self._puppets, cars, strict=True):
      puppet.pose(self._data.qpos, np.nan_to_num(row), elapsed)
    settle_view(self._model, self._data)
    self._context.make_current()
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(self._model, self._data, self._option, None, self._camera, everything, self._scene)
    view = mujoco.MjrRect(0, 0, self.look.width, self.look.height)
    mujoco.mjr_render(view, self._scene, self._drawing)
    if text:
      place, font = mujoco.mjtGridPos.mjGRID_TOPLEFT, mujoco.mjtFont.mjFONT_NORMAL
      mujoco.mjr_overlay(font, place, view, text, "", self._drawing)
    picture = np.empty((self.look.height, self.look.width, 3), dtype=np.uint8)
    mujoco.mjr_readPixels(picture, None, view, self._drawing)
    return np.ascontiguousarray(picture[::-1])

  def frames(
    self, signals: Array, ghost: Array | None = None, period: float = 0.01, label: str = ""
  ) -> Iterator[Picture]:
    """Pictures of a drive, signals (T, 10) and ghost (T', 10) every `period` s, time, speed and error written in."""
    stride = 1.0 / (self.look.fps * period)
    rows = np.round(np.arange(0.0, len(signals) - 0.5, stride)).astype(int)
    errors = self.cross_track_errors(signals[rows]) if self.path is not None else None
    for k, row in enumerate(rows):
      other = None if ghost is None else ghost[min(row, len(ghost) - 1)]
      lines = [label] * bool(label) + [
        f"time   {row * period:6.2f} s",
        f"speed  {np.hypot(*signals[row, VELOCITY]):6.2f} m/s",
      ]
      if errors is not None:
        lines.append(f"error  {1e3 * errors[k]:+6.1f} mm")
      yield self.frame(signals[row], other, "\n".join(lines), 1.0 / self.look.fps)

  def cross_track_errors(self, signals: Array) -> Array:
    """Cross-track errors of rows (T, 10) in driving order, m, (T,), positive to the left of the path.

    Raises:
      ValueError: this film has no path.
    """
    if self.path is None:
      raise ValueError("a film without a path has no cross-track errors; give Film the path")
    near, out = np.zeros(1), np.empty(len(signals))
    for k, row in enumerate(np.nan_to_num(signals)):
      near = self.path.nearest(row[:1], row[1:2], near=near)
      out[k] = self.path.errors(near, row[None, POSE], row[None, VELOCITY], row[YAW_RATE, None]).cross_track[0]
    return out

  def close(self) -> None:
    """Give the OpenGL context back."""
    if self._context is not None:
      self._context.make_current()
      self._drawing.free()  # now: left to the garbage collector it would free buffers of another film's context
      self._context.free()
      self._context = None


_OPEN: weakref.WeakSet[Film] = weakref.WeakSet()


def _close_all() -> None:
  """Close films that nobody closed, as of an environment in a short script, before the interpreter ends."""
  for film in list(_OPEN) if _OPENED[0] == os.getpid() else ():
    with contextlib.suppress(Exception):  # its thread may hold the context still
      film.close()


def require_film(file: File) -> None:
  """Raises ValueError where a file's name is not one that H.264 goes into."""
  if file.suffix.lower() not in FILMS:
    raise ValueError(f"{file}: a film is H.264; name a file that ends in {', '.join(FILMS[:-1])} or {FILMS[-1]}")


def write_video(file: File, pictures: Iterator[Picture], fps: int) -> int:
  """Write pictures of equal size as mp4 (H.264), replacing the file in one go; the number of frames.

  Raises:
    ValueError: there are no pictures, or the name is no film's.
  """
  require_film(file)
  with extra("Writing a film"):
    import imageio_ffmpeg

  first = next(pictures, None)
  if first is None:
    raise ValueError(f"{file.name}: no frames to write")
  size = (first.shape[1], first.shape[0])
  count = 0
  with whole_file(file) as part:
    writer = imageio_ffmpeg.write_frames(str(part), size, fps=fps, quality=7, macro_block_size=2)
    writer.send(None)
    try:
      for picture in itertools.chain([first], pictures):
        writer.send(np.ascontiguousarray(picture))
        count += 1
    finally:
      writer.close()
    _require_whole(part, count)
  return count


def _require_whole(video: File, frames: int) -> None:
  """Raises OSError where the encoder, which says nothing of it, could not write all frames."""
  with extra("Writing a film"):
    import imageio_ffmpeg

  try:
    if (imageio_ffmpeg.count_frames_and_secs(str(video))[0] or 0) >= frames:
      return
  except RuntimeError:
    pass  # cut off in the middle
  with open(video, "ab") as file:  # what stopped the encoder stops this, and says why
    file.write(bytes(4096))
  raise OSError(errno.EIO, "the video could not be written whole", str(video))


def write_still(file: File, picture: Picture) -> None:
  """Write a picture as PNG."""
  with extra("Writing a picture"):
    import imageio.v3 as imageio

  with whole_file(file) as part:
    part.write_bytes(imageio.imwrite("<bytes>", picture, extension=".png"))


def signals_of(channels: dict[str, Array]) -> Array:
  """Rows of plant.SIGNALS, (T, 10), from recorded channels on one clock, (T,) each; what is missing is zero.

  Speed stands in for the forward velocity, the steering command for the steering angle.

  Raises:
    KeyError: no pose: there is nothing to show.
  """
  missing = [name for name in ("pose_x", "pose_y", "pose_yaw") if name not in channels]
  if missing:
    raise KeyError(f"the recording has no {', '.join(missing)}: a car can only be shown where its pose was measured")
  substitutes = {"velocity_x": "speed", "steering_angle": "steering_command"}
  none = np.zeros(len(channels["pose_x"]))
  columns = [channels.get(name, channels.get(substitutes.get(name, ""), none)) for name in SIGNALS]
  return np.stack(columns, axis=-1)
