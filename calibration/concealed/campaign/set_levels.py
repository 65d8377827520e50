"""The weights of what is claimed, from answers of campaigns: a logistic regression of "the name is there"."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.linear_model import LogisticRegression

from calibration.diagnosis.decision.levels import Levels
from qcar_twin.atomic_io import write_text

WEIGHTS = ("constant", "t", "size", "margin")


def fitted_weights(results: Sequence[Mapping[str, Any]], levels: Levels, typical: bool = True) -> dict[str, float]:
  """Constant and weights of `Levels.probability`.

  Every case counts once, however many names were scored in it; names at a bound are left out, since they are never
  claimed. A unit Gaussian prior on the weights of standardised figures keeps them finite.

  Args:
    results: answers with the figures of every name that was scored, `scored`, and the truth.
    levels: what limits the figures.
    typical: whether the share of the typical size counts; its weight is 0 otherwise.

  Raises:
    ValueError: no answer has such figures, or all names are right or all wrong.
  """
  figures, right, shares = [], [], []
  for result in results:
    rows = [r for r in result["answer"].get("scored", ()) if not r["at_bound"]]
    there = {effect["id"] for effect in result["truth"]}
    figures += [levels.figures(r["t"], r["size"], r["margin"]) for r in rows]
    right += [r["name"] in there for r in rows]
    shares += [1.0 / max(len(rows), 1)] * len(rows)
  if len(set(right)) < 2:
    raise ValueError(f"{len(results)} answers score no name that is there and one that is not; answer more cases")
  kept = [0, 1, 2] if typical else [0, 2]
  x, weight = np.array(figures)[:, kept], np.array(shares) * len(shares) / np.sum(shares)
  middle, spread = x.mean(axis=0), x.std(axis=0) + 1e-9
  regression = LogisticRegression(C=1.0, max_iter=2000).fit((x - middle) / spread, right, sample_weight=weight)
  slopes = regression.coef_[0] / spread
  constant = float(regression.intercept_[0] - slopes @ middle)
  told = dict.fromkeys(WEIGHTS, 0.0) | dict(zip((WEIGHTS[1 + k] for k in kept), map(float, slopes), strict=True))
  return told | {"constant": constant}


def write_weights(weights: Mapping[str, float], command: str, file: Path) -> None:
  """Write the weights, and the command that made them, into a file of levels; the rest of it stays."""
  text = file.read_text(encoding="utf-8")
  for name, value in weights.items():
    table = re.compile(rf'(\[{name}\]\nvalue = )\S+(\nunit = "[^"\n]*"\nsource = "[^"\n]*"\ncommand = )"[^"\n]*"')
    text, count = table.subn(lambda m, v=value: f'{m[1]}{v:.3f}{m[2]}"{command}"', text)
    if count != 1:
      raise ValueError(f"{file}: has no table [{name}] with value, unit, source and command in this order; write one")
  write_text(file, text)
