"""Names that a person wrote in a car's table: the nearest of what there is, and what is left out, said once."""

import difflib
import functools
import logging
from collections.abc import Iterable

from qcar_twin.vehicle.drive import MOTOR_FIGURES

log = logging.getLogger(__name__)
_ALIKE = 0.8  # of two names of numbers, from which the one is the other misspelt


def meant(name: str, known: Iterable[str], alike: float = 0.6) -> str:
  """The ending of an error text: the known name that is nearest, "" where none is near."""
  near = difflib.get_close_matches(name, list(known), n=1, cutoff=alike)
  return f"; did you mean '{near[0]}'?" if near else ""


def refuse_misspelt(names: Iterable[str], known: Iterable[str]) -> None:
  """Raises ValueError for a name that is unknown and near to one that was not said."""
  said, known = list(names), [*known, *MOTOR_FIGURES]
  free = [name for name in known if name not in said]
  for name in said:
    if name not in known and (ending := meant(name, free, _ALIKE)):
      raise ValueError(f"has unknown key '{name}'{ending}")


def refuse_unknown(names: Iterable[str], numbers: Iterable[str]) -> None:
  """Raises ValueError for a name that is none of a vehicle's numbers, with the nearest of them or some."""
  numbers = sorted(numbers)
  for name in names:
    if name not in (*numbers, *MOTOR_FIGURES):
      near = difflib.get_close_matches(name, numbers, n=2) or numbers[:9]
      raise ValueError(f"a vehicle has no '{name}'; did you mean {', '.join(near)}?")


@functools.cache  # a command makes a car of the same table several times
def say_left_out(name: str, drive: str, numbers: tuple[str, ...]) -> None:
  """Log that a number is not read: no car has it, or none of its drive; with the nearest of a car's."""
  why = f'says nothing of a drive = "{drive}"' if name in MOTOR_FIGURES else "is not a number this twin knows"
  log.warning("[vehicle]: '%s' %s and is left out%s", name, why, meant(name, numbers, _ALIKE))
