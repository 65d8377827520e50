"""Whose algebra predicts and corrects: the batched one of `kalman`, for any number of cars, or filterpy's, for one.

filterpy's `ExtendedKalmanFilter` takes a fix as a joint update with a matrix inverse and Joseph's form. Models, gates
and watches are the same; states and covariances agree to rounding.
"""

from types import ModuleType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from qcar_twin.estimation import kalman
from qcar_twin.extras import extra
from qcar_twin.recordings.recording import nearest

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Engine = Literal["batched", "filterpy"]
ENGINES: tuple[str, ...] = get_args(Engine)


def engine_of(name: Engine, count: int) -> "ModuleType | Filterpy":
  """Functions `predict`, `absorb`, `correct` and `correct_together` as in `kalman`, for `count` cars.

  Raises:
    ValueError: no such engine, or filterpy for several cars.
    MissingExtra: filterpy is not installed.
  """
  if name == "batched":
    return kalman
  if name != "filterpy":
    raise ValueError(f"no filter engine '{name}'{nearest(name, ENGINES)}")
  if count != 1:
    raise ValueError(f"the engine filterpy is for one car, not for {count}; take the engine batched")
  return Filterpy()


class Filterpy:
  """The functions of `kalman` for one car, (1, n) and (1, n, n), computed by filterpy."""

  def __init__(self) -> None:
    with extra("The filter engine filterpy"):
      from filterpy.kalman import ExtendedKalmanFilter
    self._kind = ExtendedKalmanFilter

  def _filter(self, state: Array, covariance: Array) -> Any:
    one = self._kind(dim_x=len(state), dim_z=1)
    one.x, one.P = state.copy(), covariance.copy()
    return one

  def predict(self, covariance: Array, transition: Array, noise: Array) -> Array:
    """F P F' + Q, (1, n, n); the state itself is stepped by the nonlinear models."""
    one = self._filter(np.zeros(covariance.shape[-1]), covariance[0])
    one.F, one.Q = np.broadcast_to(transition, covariance.shape)[0], np.broadcast_to(noise, covariance.shape)[0]
    one.predict()
    return np.asarray(one.P)[None]

  def absorb(
    self, state: Array, covariance: Array, column: Array, spread: Array, innovation: Array, used: Mask
  ) -> tuple[Array, Array]:
    """One scalar measurement along a slope h: `column` P h and `spread` h' P h + R, as in `kalman.absorb`."""
    if not used[0]:
      return state, covariance
    slope = np.linalg.solve(covariance[0], column[0])
    noise = np.array([[spread.item(0) - slope @ column[0]]])
    one = self._filter(state[0], covariance[0])
    one.update(innovation[:1], lambda _: slope[None], lambda _: np.zeros(1), noise)
    return np.asarray(one.x)[None], np.asarray(one.P)[None]

  def correct(
    self, state: Array, covariance: Array, row: int, value: Array, noise: Array | float, used: Mask
  ) -> tuple[Array, Array, Array, Array]:
    """A measured component of the state, as in `kalman.correct`."""
    variance = np.broadcast_to(np.asarray(noise, dtype=np.float64), 1)
    innovation = np.where(used, value - state[:, row], 0.0)
    spread = covariance[:, row, row] + variance
    done = self.correct_together(state, covariance, (row,), value[:, None], variance[:, None], used[:, None])
    return done.state, done.covariance, innovation, spread

  def correct_together(
    self, state: Array, covariance: Array, rows: Any, values: Array, noise: Array, used: Mask
  ) -> kalman.Corrected:
    """A fix of several components, jointly, as in `kalman.correct_together`."""
    there = np.flatnonzero(used[0])
    if not len(there):
      return kalman.Corrected(state, covariance, np.zeros(1), np.zeros(1))
    slopes = np.eye(state.shape[1])[np.asarray(rows)[there]]
    innovation = values[0, there] - slopes @ state[0]
    one = self._filter(state[0], covariance[0])
    one.update(innovation, lambda _: slopes, lambda _: np.zeros(len(there)), np.diag(noise[0, there]))
    nis = innovation @ np.linalg.solve(one.S, innovation)
    return kalman.Corrected(
      np.asarray(one.x)[None], np.asarray(one.P)[None], np.array([nis]), np.linalg.slogdet(one.S)[1][None]
    )
