"""What a diagnosis believes about a car, as a file: models by probability, with parameters and their covariance.

An episode of a training draws a model by its probability, then its parameters from a normal distribution. Mechanisms
that the model lacks are at their null.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.atomic_io import plain, write_json
from qcar_twin.plant import SUBSTEPS, Plant
from qcar_twin.twin.file import load_twin
from qcar_twin.twin.mechanisms import catalogue, select
from qcar_twin.twin.twin import Twin
from qcar_twin.untrusted import UnreadableFile, is_number, read_json

Array = NDArray[np.float64]
FILE, BASE = "posterior.json", "recalibrated.toml"  # in a diagnosis's folder


@dataclasses.dataclass(frozen=True)
class Believed:
  """One model.

  Attributes:
    mechanisms: ids in it.  probability: that it is the right one.
    names: of its k parameters.  values, covariance: their mean (k,) and covariance (k, k), in the parameters' units.
  """

  mechanisms: tuple[str, ...]
  probability: float
  names: tuple[str, ...]
  values: Array
  covariance: Array


@dataclasses.dataclass(frozen=True)
class Posterior:
  """All models; their probabilities sum up to 1."""

  models: tuple[Believed, ...]

  @property
  def mechanisms(self) -> tuple[str, ...]:
    """Of any model, in the order in which they first occur."""
    return tuple(dict.fromkeys(name for model in self.models for name in model.mechanisms))

  def draw(self, plant: Plant, theta: Array, rng: np.random.Generator) -> Array:
    """One parameter vector, (P,): a model, its parameters cut at their bounds, what it lacks as in theta, (P,)."""
    model = self.models[rng.choice(len(self.models), p=[m.probability for m in self.models])]
    columns = [plant.parameters.index(name) for name in model.names]
    out = np.array(theta)
    drawn = model.values + normal_step(model.covariance, rng)
    out[columns] = np.clip(drawn, plant.parameters.lower[columns], plant.parameters.upper[columns])
    return out


def normal_step(covariance: Array, rng: np.random.Generator) -> Array:
  """A draw from a normal distribution about zero, (k,), with a covariance (k, k) that may be singular."""
  values, vectors = np.linalg.eigh(covariance)
  return vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(values)))


def save_posterior(folder: Path, posterior: Posterior) -> Path:
  """Write a posterior into a diagnosis's folder; returns the file."""
  return write_json(folder / FILE, plain({"models": [dataclasses.asdict(m) for m in posterior.models]}))


def load_posterior(folder: str | Path) -> Posterior:
  """What `save_posterior` wrote.

  Raises:
    FileNotFoundError, UnreadableFile: with the file's name, the entry and the cure.
  """
  source = Path(folder) / FILE
  if not source.is_file():
    raise FileNotFoundError(f"{source}: no such file; qcar-twin diagnose --out {folder} writes it")
  entries = read_json(source).get("models")
  if not isinstance(entries, list) or not entries:
    raise UnreadableFile(f"{source}: has no list of models; write it again with qcar-twin diagnose")
  models = [_read(f"{source}: model {k}", entry) for k, entry in enumerate(entries)]
  if abs(sum(m.probability for m in models) - 1.0) > 1e-6:
    raise UnreadableFile(f"{source}: the models' probabilities do not sum up to 1; write it again")
  return Posterior(tuple(models))


def believed_twin(folder: str | Path, substeps: int = SUBSTEPS, threads: int = 0) -> tuple[Twin, Array]:
  """The twin that can be any of a posterior's models, and its parameters (P,) without any of their mechanisms."""
  twin, theta = load_twin(Path(folder) / BASE, substeps, threads)
  posterior, known = load_posterior(folder), {m.name for m in twin.mechanisms}
  # errors that every model fits are not in a twin file where they are nought
  owners = {p.name: m.name for m in catalogue().values() for p in m.parameters}
  fitted = [owners[n] for model in posterior.models for n in model.names if n in owners and n not in twin.base]
  added = [name for name in dict.fromkeys([*posterior.mechanisms, *fitted]) if name not in known]
  able = twin.with_mechanisms([*twin.mechanisms, *select(added)])
  return able, able.parameters.vector(twin.parameters.named(theta))


def _read(where: str, entry: Any) -> Believed:
  """A model of the file, checked."""
  try:
    names, mechanisms = _texts(entry["names"]), _texts(entry["mechanisms"])
    values, covariance = np.array(entry["values"], float), np.array(entry["covariance"], float)
    probability = entry["probability"]
  except (KeyError, TypeError, ValueError) as error:
    raise UnreadableFile(f"{where} cannot be read ({error}); write it again with qcar-twin diagnose") from error
  right = values.shape == (len(names),) and covariance.shape == (len(names), len(names))
  finite = np.isfinite(values).all() and np.isfinite(covariance).all()
  if not (right and finite and is_number(probability) and 0.0 <= probability <= 1.0):
    raise UnreadableFile(f"{where} has numbers that don't fit its {len(names)} names; write it again")
  return Believed(mechanisms, float(probability), names, values, covariance)


def _texts(values: Sequence[Any]) -> tuple[str, ...]:
  """A list of texts. Raises TypeError for anything else."""
  if not isinstance(values, list) or not all(isinstance(v, str) for v in values):
    raise TypeError(f"{values!r:.40} is no list of names")
  return tuple(values)
