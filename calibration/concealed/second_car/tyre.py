"""Rubber on the floor: averaged LuGre friction of a contact patch, along and across at once.

Canudas de Wit and Tsiotras, CDC 1999; Velenis, Tsiotras, Canudas de Wit and Sorine, Veh. Syst. Dyn. 43(1), 2005:
  z_j' = v_j - (s_j |v| / g + k_j |w r|) z_j,   F_j = -F_z (s_j z_j + d(v) z_j'),   j = x, y,
  g = mu_k + (mu_s - mu_k) exp(-sqrt(|v| / v_s)),
v the sliding velocity of the rubber over the floor. k_j L is such that the steady force is that of bristles spread
evenly over a patch of length L: k L = (1 - e^-q) / f, f = 1 - (1 - e^-q) / q, q = s L |v| / (g |w r|). So the
stiffness at small slip is s L / 2 times the load, the way to build up a force L / 2.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

SLOWEST = 1e-3  # m/s added to |w r| in q
FADE = 0.1  # m/s of sliding by which the bristles' damping has halved


def bristle_stiffness(car: SimpleNamespace) -> np.ndarray:
  """s along and across (2, 4, n) [1/m] at the load of rest, with the patch the tyres are given."""
  across = np.stack([car.cornering_front, car.cornering_front, car.cornering_rear, car.cornering_rear])
  along = np.broadcast_to(car.slip_stiffness, across.shape)
  return 2.0 * np.stack([along, across]) / patch(car)


def patch(car: SimpleNamespace) -> np.ndarray:
  """Length of the patches (4, n) [m]; a carcass that yields acts as a longer one of softer bristles."""
  front = car.patch_length + 2.0 * car.relaxation_front
  return np.stack([front, front, car.patch_length, car.patch_length])


def tyre_forces(
  car: SimpleNamespace, bristle: np.ndarray, slide: np.ndarray, rolling: np.ndarray, load: np.ndarray,
  stiffness: np.ndarray, grip: np.ndarray, relative: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
  """Forces on the car and rates of the bristles, both (2, 4, n) [N, m/s].

  Args:
    car: columns (n,).
    bristle, slide: deflection [m] and sliding velocity [m/s] along and across, (2, 4, n).
    rolling: |w r| (4, n) [m/s].
    load: (4, n) [N]; relative: load over the load at rest.
    stiffness: (2, 4, n) from `bristle_stiffness`.
    grip: factor on friction (4, n).
  """
  length = patch(car)
  less = np.maximum(relative, 0.05) ** -car.load_fall
  speed = np.sqrt(slide[0] * slide[0] + slide[1] * slide[1] + 1e-12)
  extra = (1.0 - car.kinetic_share) * np.exp(-np.sqrt(speed / car.stribeck_speed))
  wear = speed / (car.static_friction * (car.kinetic_share + extra) * grip * less)
  stiff = stiffness * less
  used = stiff * wear
  q = np.clip(used * (length / (rolling + SLOWEST)), 1e-3, 50.0)
  gone = -np.expm1(-q)
  carried = gone / (1.0 - gone / q) / length * rolling
  rate = slide - (used + carried) * bristle
  damping = car.bristle_damping / (1.0 + (speed / FADE) ** 2)
  return -load * (stiff * bristle + damping * rate), rate
