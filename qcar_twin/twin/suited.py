"""Mechanisms for a car: of its drive, with sizes of its own."""

import copy
import dataclasses
from collections.abc import Iterable, Mapping

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import CarDimensions, Mechanism
from qcar_twin.vehicle.similarity import Similarity
from qcar_twin.vehicle.vehicle import Vehicle


def suited(mechanisms: Iterable[Mechanism], vehicle: Vehicle) -> tuple[Mechanism, ...]:
  """The same mechanisms, their sizes carried over to a car of this size.

  Raises:
    ValueError: one of them presupposes another drive.
  """
  chosen = tuple(mechanisms)
  for mechanism in chosen:
    if not isinstance(mechanism, Mechanism):
      raise TypeError(f"{mechanism!r:.60} is no mechanism; mechanisms by name come from select([...])")
    if vehicle.drive not in mechanism.drives:
      raise ValueError(
        f"mechanism '{mechanism.name}' is physics of a drive by {' or '.join(mechanism.drives)}; {vehicle.name} is"
        f" driven by {vehicle.drive}: leave it out"
      )
  carried = chosen if vehicle.similarity.length == 1.0 else tuple(_carried(m, vehicle.similarity) for m in chosen)
  return tuple(sought(m, CarDimensions.of(vehicle), vehicle.std) for m in carried)


def sought(mechanism: Mechanism, car: CarDimensions, std: Mapping[str, float]) -> Mechanism:
  """The mechanism with no amplitude typically smaller than what is usual of this car, see `Mechanism.tolerances`."""
  usual = mechanism.tolerances(car, std)
  sizes = {
    p: max(p.typical, usual.get(p.name, 0.0))
    for p in mechanism.parameters
    if p.typical is not None and p.null is not None
  }
  if all(size == p.typical for p, size in sizes.items()):
    return mechanism
  return _with(mechanism, [dataclasses.replace(p, typical=sizes.get(p, p.typical)) for p in mechanism.parameters])


def _carried(mechanism: Mechanism, similarity: Similarity) -> Mechanism:
  """The mechanism with parameters for cars of another size; from what was declared, however often it is done."""
  declared = vars(mechanism).get("declared", mechanism.parameters)
  return _with(mechanism, map(similarity.carried, declared))


def _with(mechanism: Mechanism, parameters: Iterable[Parameter]) -> Mechanism:
  """The same with other parameters, which remembers those that were declared."""
  made = copy.copy(mechanism)
  declared = vars(mechanism).get("declared", mechanism.parameters)
  vars(made).update(declared=declared, parameters=tuple(parameters))
  return made
