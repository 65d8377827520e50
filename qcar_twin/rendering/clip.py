"""A short film of one drive with a second, translucent car, first as one model has it, then as another."""

import io
import itertools
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgba
from numpy.typing import NDArray

from qcar_twin.extras import extra
from qcar_twin.plant import POSITION
from qcar_twin.rendering.film import Film, Look, Picture, write_video
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

_SEEN = 0.4  # m to the side of the car, within the chase camera's view
_HELD = 1.0  # s that the film stands at the moment where the two are apart, before it runs
LOOK = Look("chase", 480, 270, fps=15, shadows=False)  # a frame takes a software renderer a twentieth of a second


def comparison_film(
  signals: Array,
  ghosts: Sequence[tuple[str, str, Array]],
  period: float,
  vehicle: Vehicle | None = None,
  look: Look = LOOK,
) -> tuple[bytes, bytes]:
  """The same drive once with each ghost, one after the other; it opens where the first ghost is apart from the car.

  Args:
    signals: rows of plant.SIGNALS of the solid car, (T, 10), every `period` s.
    ghosts: what is written in, colour and signals (T, 10) of each translucent car.

  Returns:
    the film as mp4, and a JPEG of the moment at which the first ghost is farthest from the car and still seen.

  Raises:
    RenderingUnavailable: there is no OpenGL.
  """
  film = Film(vehicle=vehicle, look=look, ghost=True)
  rows = np.round(np.arange(0.0, len(signals) - 0.5, 1.0 / (look.fps * period))).astype(int)
  try:
    parted = _parted(film, signals, ghosts[0], rows, period)
    with tempfile.TemporaryDirectory() as folder:
      file = Path(folder) / "film.mp4"
      held = itertools.repeat(parted, round(_HELD * look.fps))
      write_video(file, itertools.chain(held, _frames(film, signals, ghosts, rows, period)), look.fps)
      return file.read_bytes(), _jpeg(parted)
  finally:
    film.close()


def _parted(
  film: Film, signals: Array, first: tuple[str, str, Array], rows: NDArray[np.int64], period: float
) -> Picture:
  """The moment at which the first ghost is farthest from the car and still seen."""
  label, colour, ghost = first
  apart = _apart(signals[rows], ghost[rows])
  film.paint_ghost(to_rgba(colour, alpha=0.45))
  shown = rows[int(np.argmax(np.where(apart <= _SEEN, apart, -apart)))]
  return film.frame(signals[shown], ghost[shown], _text(label, shown * period, _apart(signals[shown], ghost[shown])))


def _frames(
  film: Film, signals: Array, ghosts: Sequence[tuple[str, str, Array]], rows: NDArray[np.int64], period: float
) -> Iterator[Picture]:
  for label, colour, ghost in ghosts:
    film.paint_ghost(to_rgba(colour, alpha=0.45))
    for row in rows:
      text = _text(label, row * period, _apart(signals[row], ghost[row]))
      yield film.frame(signals[row], ghost[row], text, 1.0 / film.look.fps)


def _apart(signals: Array, ghost: Array) -> Array:
  """Distance of the two cars, m; rows of plant.SIGNALS, (..., 10)."""
  return np.linalg.norm(ghost[..., POSITION] - signals[..., POSITION], axis=-1)


def _text(label: str, time: float, apart: Array) -> str:
  return f"{label}\ntime  {time:5.2f} s\napart {1e3 * float(apart):5.0f} mm"


def _jpeg(picture: Picture) -> bytes:
  with extra("Writing a picture"):
    import imageio.v3 as imageio

  buffer = io.BytesIO()
  imageio.imwrite(buffer, picture, extension=".jpg", quality=85)
  return buffer.getvalue()
