"""A speed controller of a model car, which answers to a duty: a transistor drives, diodes carry the rest, and it brakes
by short circuit (mechanism drive_one_way has the equation and its source).

It goes by the motor's speed from step to step: diodes that answered to a period's first speed would drive a motor that
slows down in it.
"""

import numpy as np
from numpy.typing import NDArray

from qcar_twin.twin.engines import Array

CORNER = 0.02  # V
NEUTRAL = 0.02  # of the supply, stated prior: twice a step of pulses that are told in hundredths
STANDS = 0.1  # V of back-EMF, stated prior: what a controller takes for a motor that stands
QUANTITIES = ("one_way", "one_way_brake", "one_way_neutral", "one_way_weakness", "one_way_reverse")
FREE, BRAKED, ON_ITS_WAY = 0.0, 1.0, 2.0  # the brake holds; it does, by a command that has not come through yet


def at_first(told: Array, back_emf: Array, supply: float) -> Array:
  """What the brake does as a log begins, (N,): what stands under a command backwards is held, but where it was told so
  just now.

  Args:
    told: V, (N,), the higher of the first command and the one before it.  back_emf, supply: V.
  """
  idle, moves = _told(told, back_emf, supply)
  return np.where((idle < 0.5) & (told < 0.0) & (moves < 0.5), ON_ITS_WAY, FREE)


def acting(command: Array, back_emf: Array, braked: Array, shares: Array, supply: float) -> tuple[Array, Array]:
  """Voltage that acts on the motor as one of four quadrants would have it, V, (N,), and what the brake does then.

  Args:
    command, back_emf: V, (N,).  braked: FREE, BRAKED or ON_ITS_WAY, (N,).  shares: of QUANTITIES, (5, N).
    supply: V, that a duty of 1 is.
  """
  one_way, brake, neutral, weakness, never = shares
  way = np.where(back_emf < 0.0, -1.0, 1.0)
  along, back = command * way, back_emf * way
  idle, moves = _told(command, back_emf, supply)
  asked = (command < 0.0) & (idle < 0.5)
  held = asked & ((braked > 0.5) | ((back_emf > 0.0) & (moves > 0.5)))
  waits = (braked > 1.5) & (idle >= 0.5)
  shorted = np.minimum(np.abs(command) / supply, 1.0) * (1.0 - weakness)
  beyond = np.maximum(back - along, 0.0)
  stopped = beyond * beyond / (beyond + CORNER)
  braked_by = brake * np.where(held, 1.0, np.where(back_emf > 0.0, moves, 0.0))
  braked_by = np.where(command < 0.0, 1.0 - (1.0 - braked_by) * (1.0 - never), 0.0)
  driving = np.where(along >= 0.0, one_way * stopped, 0.0)
  told = braked_by * (back * (1.0 - shorted) - along) + (1.0 - braked_by) * driving
  volts = command + way * (idle * neutral * stopped + (1.0 - idle) * told)
  return volts, np.where(held, BRAKED, np.where(waits, ON_ITS_WAY, FREE))


def _told(command: Array, back_emf: Array, supply: float) -> tuple[Array, Array]:
  """How far commands are neutral, and how far motors move, (N,) each, 0 to 1."""
  ratio = np.minimum(np.abs(command) / (NEUTRAL * supply), 1e3) ** 2
  back = back_emf**2
  return 1.0 / (1.0 + ratio * ratio), back / (back + STANDS**2)


def present(values: dict[str, Array]) -> NDArray[np.bool_]:
  """Cars with such a controller, (N,)."""
  return np.any([values[name] != 0.0 for name in QUANTITIES], axis=0)
