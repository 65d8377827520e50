"""Start states of cars whose tyres slip, from what was measured of cars that were under way.

Where a simulation begins in mid-drive, an encoder says how fast the wheels turn, not how fast the car moves, and
nothing says how it slides. Both follow from the forces the tyres carry there (Rajamani, Vehicle Dynamics and Control,
2nd ed., 2012, ch. 2.2 and 4.1), with each car's own stiffnesses:

  v_x = v_w (1 - m a_x / C_x),   v_y = r l_r - v_x alpha_r,   alpha_r = m v_x r l_f / (L C_r)

with the wheels' speed on the road v_w, its rate of change a_x and the share of C_x that the driven axles have. Else
every stretch that begins while the car accelerates begins too fast, and its motor's speed jumps up by the slip.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from qcar_twin.plant import START

Array = NDArray[np.float64]

_LARGEST = 0.2  # slip, -, up to which a tyre's force is taken for proportional to it
_SPEED, _SIDE, _TURN = (START.index(name) for name in ("velocity_x", "velocity_y", "yaw_rate"))


def slipping(start: Array, rate: Array, values: Mapping[str, Array], wheelbase: float, driven: float) -> Array:
  """Start states, (N, 7), of cars that slip.

  Args:
    start: those of cars that roll without slip, (N, 7), in the order of START.
    rate: how fast these change, per s, (N, 7).
    values: the cars' base parameters by name, (N,) each.
    wheelbase: m.
    driven: share of the longitudinal stiffness that the driven axles have.
  """
  out, (speed, turn) = start.copy(), (start[:, _SPEED], start[:, _TURN])
  along = values["mass"] * rate[:, _SPEED] / (driven * values["longitudinal_stiffness"])
  share = values["cg_to_front"] / (wheelbase * values["cornering_stiffness_rear"])
  out[:, _SPEED] = speed * (1.0 - np.clip(along, -_LARGEST, _LARGEST) * np.sign(speed))
  out[:, _SIDE] -= np.abs(speed) * np.clip(values["mass"] * speed * turn * share, -_LARGEST, _LARGEST)
  return out
