"""A short film of one drive with a translucent car next to it, first as one model has it, then as another."""

import io
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgba
from numpy.typing import NDArray

from qcar_twin.plant import POSITION
from qcar_twin.rendering.film import Film, Look, Picture, write_video
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

_SEEN = 0.4  # m to the side of the car, within the chase camera's view
LOOK = Look("chase", 480, 270, fps=15, shadows=False)  # a frame takes a software renderer a twentieth of a second


def comparison_film(
  signals: Array,
  ghosts: Sequence[tuple[str, str, Array]],
  period: float,
  vehicle: Vehicle | None = None,
  look: Look = LOOK,
) -> tuple[bytes, bytes]:
  """The same drive once with each ghost, one after the other.

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
    with tempfile.TemporaryDirectory() as folder:
      file = Path(folder) / "film.mp4"
      write_video(file, _frames(film, signals, ghosts, rows, period), look.fps)
      mp4 = file.read_bytes()
    label, colour, ghost = ghosts[0]
    apart = np.hypot(*(ghost[rows, POSITION] - signals[rows, POSITION]).T)
    film.paint_ghost(to_rgba(colour, alpha=0.45))
    shown = rows[int(np.argmax(np.where(apart <= _SEEN, apart, -apart)))]
    return mp4, _jpeg(film.frame(signals[shown], ghost[shown], label))
  finally:
    film.close()


def _frames(
  film: Film, signals: Array, ghosts: Sequence[tuple[str, str, Array]], rows: NDArray[np.int64], period: float
) -> Iterator[Picture]:
  for label, colour, ghost in ghosts:
    film.paint_ghost(to_rgba(colour, alpha=0.45))
    for row in rows:
      apart = float(np.hypot(*(ghost[row, POSITION] - signals[row, POSITION])))
      text = f"{label}\ntime  {row * period:5.2f} s\napart {1e3 * apart:5.0f} mm"
      yield film.frame(signals[row], ghost[row], text, 1.0 / film.look.fps)


def _jpeg(picture: Picture) -> bytes:
  import imageio.v3 as imageio

  buffer = io.BytesIO()
  imageio.imwrite(buffer, picture, extension=".jpg", quality=85)
  return buffer.getvalue()
