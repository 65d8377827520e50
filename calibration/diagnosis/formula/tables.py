"""Tables of one or two variables: what a formula is held against, and what is shipped where none holds."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.formula.columns import Driven, Fitted
from calibration.diagnosis.formula.moments import by_pulse
from calibration.diagnosis.formula.pulses import Responses
from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.table import hats
from qcar_twin.twin.formula.variables import VARIABLES

Array = NDArray[np.float64]

_KNOTS, _KNOTS_OF_TWO = 7, 5
_STIFFNESS = (1e2, 1e3, 1e4)  # precisions of heights, over shares of the degree's scale: a tenth to a hundredth of it
_FLIPS = 300


@dataclasses.dataclass(frozen=True)
class TableFit:
  """The best table.

  Attributes:
    names: its variables, one or two.
    gain: held out, nats.
    stiffness: precision of its heights, as shares of the degree's scale.
    chance: probability that the best of all tables gains as much on a target whose stretches have other signs.
  """

  names: tuple[str, ...]
  gain: float
  stiffness: float
  chance: float


def best_table(responses: Responses, driven: Driven, fitted: Fitted, random: np.random.Generator) -> TableFit:
  """The table with the largest held-out gain of all that are tried, with the chance of that.

  Args:
    responses: of a degree of freedom.
    driven, fitted: the driving, and what is fitted of it.
    random: draws the signs.
  """
  degree = responses.degree
  usable = [n for n in driven.values if not DEGREES[degree].signal or VARIABLES[n].needs == "signals"]
  first = np.unique(fitted.witness, return_index=True)[1]
  kinds, where = np.unique(fitted.group[first], return_inverse=True)
  signs = np.vstack([np.ones(len(first)), random.choice([-1.0, 1.0], size=(_FLIPS, len(first)))])
  into = np.zeros((len(kinds), len(first)))
  into[where, np.arange(len(first))] = 1.0
  most, best = np.full(len(signs), -np.inf), (-np.inf, ("",), 0.0)
  for names in tables(usable):
    columns = fitted.columns(responses, table_shapes(degree, driven, table_knots(driven, names)) * responses.scale)
    scores = np.stack(
      [columns[fitted.witness == w].T @ fitted.rest[fitted.witness == w] for w in fitted.witness[first]]
    )
    inner = np.stack([(part := columns[fitted.group == kind]).T @ part for kind in kinds])
    pulls = np.einsum("gw,fw,wd->fgd", into, signs, scores, optimize=True)
    for stiffness in _STIFFNESS:
      gains = table_gains(inner, pulls, stiffness)
      best, most = max(best, (float(gains[0]), names, stiffness)), np.maximum(most, gains)
  gain, names, stiffness = best
  return TableFit(names, gain, stiffness, float((1 + np.sum(most[1:] >= most[0])) / len(most)))


def table_gains(inner: Array, pulls: Array, stiffness: float) -> Array:
  """Held-out gains of all heights together under a prior precision, nats, (F,).

  Args:
    inner: products of columns by group of data, (G, d, d).
    pulls: theirs with the targets, (F, G, d).
    stiffness: the precision.
  """
  held = np.linalg.inv(inner.sum(axis=0) - inner + stiffness * np.eye(inner.shape[1]))
  rest = np.einsum("gij,fgj->fgi", held, pulls.sum(axis=1, keepdims=True) - pulls)
  return np.einsum("fgi,fgi->f", rest, pulls) - 0.5 * np.einsum("fgi,gij,fgj->f", rest, inner, rest, optimize=True)


def table_heights(
  responses: Responses, driven: Driven, fitted: Fitted, names: Sequence[str], stiffness: float
) -> Array:
  """Heights of a table, in the degree's unit, under a prior precision."""
  columns = fitted.columns(
    responses, table_shapes(responses.degree, driven, table_knots(driven, names)) * responses.scale
  )
  inner = columns.T @ columns + stiffness * np.eye(columns.shape[1])
  return np.asarray(np.linalg.solve(inner, columns.T @ fitted.rest) * responses.scale, dtype=np.float64)


def tables(usable: Sequence[str]) -> list[tuple[str, ...]]:
  """Which variables tables are tried over."""
  present = [n for n in usable if not VARIABLES[n].memory and not n.startswith("place_")]
  single = [(n,) for n in usable if not n.startswith("place_")]
  place = [("place_x", "place_y")] if {"place_x", "place_y"} <= set(usable) else []
  moving = [n for n in present if not VARIABLES[n].angular]
  return [*single, *itertools.combinations(moving, 2), *place]


def table_knots(driven: Driven, names: Sequence[str]) -> dict[str, tuple[float, ...]]:
  """Evenly spread over what was driven; an angle's over a turn."""
  count, out = _KNOTS if len(names) == 1 else _KNOTS_OF_TWO, {}
  for name in names:
    low, high = (-np.pi, np.pi) if VARIABLES[name].angular else np.quantile(driven.values[name], [0.005, 0.995])
    out[name] = tuple(np.linspace(low, high if high > low else low + 1e-6, count).tolist())
  return out


def table_shapes(degree: str, driven: Driven, knots: Mapping[str, tuple[float, ...]]) -> Array:
  """Hats of a table by pulse, (S, K, heights)."""
  axes = [hats(driven.values[n], np.array(at), VARIABLES[n].angular) for n, at in knots.items()]
  basis = axes[0] if len(axes) == 1 else (axes[0][..., :, None] * axes[1][..., None, :]).reshape(
    *axes[0].shape[:-1], -1)  # fmt: skip
  fade = driven.fade[..., None] if DEGREES[degree].fades else 1.0
  return by_pulse(basis * fade, driven.period)
