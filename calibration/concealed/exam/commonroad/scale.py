"""The published car's numbers at another size: what keeps every dimensionless group as it is.

Lengths go by k, masses by q, and gravity is the same at every size (Buckingham, 1914; Froude's number v^2 / (g L)). So

    time, speed         sqrt(k)           force               q
    inertia             q k^2             stiffness  N/m      q / k
    damping  N s/m      q / sqrt(k)       stiffness  N m/rad  q k
    rad/m               1 / k             1/N                 1 / q
    m/N                 k / q             rad/s               1 / sqrt(k)

Angles, friction and slip stiffness over load have no unit and stay.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

_LENGTHS = ("l", "w", "a", "b", "T_f", "T_r", "h_cg", "h_raf", "h_rar", "h_s", "R_w")
_MASSES = ("m", "m_s", "m_uf", "m_ur")
_INERTIAS = ("I_Phi_s", "I_y_s", "I_z", "I_xz_s", "I_uf", "I_ur", "I_y_w")
_STIFFNESSES = ("K_sf", "K_sr", "K_ras", "K_zt")
_DAMPINGS = ("K_sdf", "K_sdr", "K_rad")
_TURNED = ("K_tsf", "K_tsr")
_PER_LENGTH, _PER_LENGTH_2 = ("D_f", "D_r"), ("E_f", "E_r")


def to_size(p: Any, length: float, mass: float) -> None:
  """Change parameters of `vehiclemodels` in place to a car of another wheelbase [m] and mass [kg]."""
  k, q = length / (p.a + p.b), mass / p.m
  for names, factor in (
    (_LENGTHS, k), (_MASSES, q), (_INERTIAS, q * k**2), (_STIFFNESSES, q / k), (_DAMPINGS, q / sqrt(k)),
    (_TURNED, q * k), (_PER_LENGTH, 1.0 / k), (_PER_LENGTH_2, k**-2.0), (("K_lt",), k / q),
  ):  # fmt: skip
    for name in names:
      setattr(p, name, getattr(p, name) * factor)
  for name in ("v_min", "v_max"):
    setattr(p.steering, name, getattr(p.steering, name) / sqrt(k))
  for name in ("v_min", "v_max", "v_switch"):
    setattr(p.longitudinal, name, getattr(p.longitudinal, name) * sqrt(k))
  p.tire.p_vx1 /= q  # the package adds load times this to an angle
