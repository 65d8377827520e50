"""Start states of cars whose tyres slip, from what was measured of cars that were under way.

Where a simulation begins in mid-drive, an encoder says how fast the driven wheels turn, not how fast the car moves, and
nothing says how it slides. In a turn each wheel rolls along its own heading, and all have a share in what the motor
turns at; the rest follows from the forces the tyres carry there (Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012,
ch. 2.2 and 4.1), with each car's own stiffnesses:

  v_w (1 - k m (a_x + v_w r l_r / L sin delta) / C_x) = v_x (1 - f + f cos delta) + (v_y + r l_f) f sin delta
  v_y = r l_r - v_w alpha_r,   alpha_r = k m v_w r l_f / (L C_r)

with the driven wheels' mean speed at the rim v_w, the acceleration a_x that the tyres give the car, what steered front
wheels hold back of it in a turn, the share of C_x that the driven axles have, the share f of the front axle among
them, and k, by how much more than a linear tyre the car's own slips at the used share of its friction,
|(a_x, v_w r)| / (mu g). Else a stretch that begins in a launch begins too fast by the slip, one in a tight turn by half
of 1 / cos delta - 1, and its motor's speed jumps up by that; and one near the limit of grip has not slid out yet, and
turns too fast for half a second.
"""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from qcar_twin.plant import LEAD, START
from qcar_twin.twin.mechanisms.base import CarDimensions
from qcar_twin.vehicle.mjcf import centre_damping
from qcar_twin.vehicle.tyre import slip_over_linear
from qcar_twin.vehicle.vehicle import GRAVITY, Vehicle

Array = NDArray[np.float64]

_LARGEST = 0.2  # slip, -, up to which a start is taken from forces
_TURNS = 2  # from a car's speed to its wheels': what they slip hardly changes by what they slip
_USED = 0.95  # of mu F_z: nearer to the peak a force does not tell the slip, since mu is known to a few percent
_BEFORE, _GAIN = LEAD.index("motor_speed"), LEAD.index("motor_acceleration")
_SPEED, _SIDE, _TURN, _STEERED = (START.index(n) for n in ("velocity_x", "velocity_y", "yaw_rate", "steering_angle"))


def slipping(start: Array, push: Array, values: Mapping[str, Array], vehicle: Vehicle) -> Array:
  """Start states, (N, 7), of cars that slip.

  Args:
    start: what was measured, (N, 7), in the order of START: along, the driven wheels' speed at the rim; aside, that of
      a rear axle that rolls without slip.
    push: acceleration that its tyres give the car along, m/s^2, (N,).
    values: the cars' base parameters by name, (N,) each.
    vehicle: numbers of the car.
  """
  out, (rim, turn, angle) = start.copy(), (start[:, _SPEED], start[:, _TURN], start[:, _STEERED])
  driven, ahead = 0.5 * len(vehicle.driven_axles), _front_share(vehicle)
  held_back = rim * turn * (1.0 - values["cg_to_front"] / vehicle.wheelbase) * np.sin(angle)
  used = np.hypot(push, rim * turn) / (values["friction_coefficient"] * GRAVITY)
  more = slip_over_linear(vehicle.tyre_law)(np.minimum(used, _USED), values)
  along = more * values["mass"] * (push + held_back) / (driven * values["longitudinal_stiffness"])
  share = values["cg_to_front"] / (vehicle.wheelbase * values["cornering_stiffness_rear"])
  out[:, _SIDE] -= np.abs(rim) * np.clip(more * values["mass"] * rim * turn * share, -_LARGEST, _LARGEST)
  rolled = rim - np.abs(rim) * np.clip(along, -_LARGEST, _LARGEST)
  aside = ahead * np.sin(angle) * (out[:, _SIDE] + turn * vehicle.cg_to_front)
  out[:, _SPEED] = (rolled - aside) / (1.0 - ahead + ahead * np.cos(angle))
  return out


def driving(
  start: Array, own: Array, push: Array, values: Mapping[str, Array], vehicle: Vehicle
) -> tuple[Array, Array]:
  """The same of cars whose measured speed is by a share their own, (N,), and by the rest their wheels'. Start states,
  (N, 7), and how fast driven wheels turn at the rim, m/s, (N,)."""
  wheels, said = start.copy(), start[:, _SPEED]
  for _ in range(_TURNS if own.any() else 0):
    speed = slipping(wheels, push, values, vehicle)[:, _SPEED]
    wheels[:, _SPEED] += said - (own * speed + (1.0 - own) * wheels[:, _SPEED])
  out = slipping(wheels, push, values, vehicle)
  out[:, _SPEED] = np.where(own == 1.0, said, out[:, _SPEED])
  return out, wheels[:, _SPEED]


def turned(start: Array, share: Array, command: Array, vehicle: Vehicle) -> Array:
  """Start states, (N, 7), whose road wheels stand by a share, (N,), nearer to a first command, (N,) rad, than where the
  car turned to."""
  out, goal = start.copy(), np.clip(command, -vehicle.max_steering, vehicle.max_steering)
  out[:, _STEERED] += share * (goal - start[:, _STEERED])
  return out


def turning(start: Array, rim: Array | None, values: Mapping[str, Array], vehicle: Vehicle) -> Array:
  """How fast the four wheels and the motor turn at start states, rad/s, (N, 5).

  A wheel that rolls turns as its place in the car moves along its heading. What the motor turns faster, all driven
  wheels slip alike: differentials give each the same torque. Between two driven axles a centre differential of damping
  b leaves 1 / (1 + 4 b v / (C_x R^2)) of the difference at which they would roll: half of C_x against the other, v the
  speed of the car; see mjcf.centre_damping.

  Args:
    start: states in the order of START, (N, 7).
    rim: the driven wheels' mean speed at the rim, m/s, (N,); None where they roll without slip.
    values: simulator quantities of the cars, see twin/parameters.py.
    vehicle: numbers of the car.
  """
  s, place = {name: start[:, i, None] for i, name in enumerate(START)}, vehicle.wheel_positions
  bend = vehicle.track_width / (2.0 * vehicle.wheelbase) * values["ackermann_fraction"][:, None]
  angle = s["steering_angle"] * [1.0, 1.0, 0.0, 0.0] + s["steering_angle"] ** 2 * bend * [1.0, -1.0, 0.0, 0.0]
  ahead, left = s["velocity_x"] - s["yaw_rate"] * place[:, 1], s["velocity_y"] + s["yaw_rate"] * place[:, 0]
  speed, share = np.cos(angle) * ahead + np.sin(angle) * left, _front_share(vehicle)
  front, rear = speed[:, :2].mean(axis=1), speed[:, 2:].mean(axis=1)
  driven = np.repeat([float(axle in vehicle.driven_axles) for axle in ("front", "rear")], 2)
  if driven.all():
    hold = values["longitudinal_stiffness"].sum(axis=1) * vehicle.wheel_radius**2
    drag = 4.0 * np.abs(start[:, _SPEED]) * centre_damping(values["centre_differential"], vehicle.similarity)
    lost = 0.5 * (front - rear) * drag / (drag + hold)
    speed += lost[:, None] * [-1.0, -1.0, 1.0, 1.0]
  mean = share * front + (1.0 - share) * rear
  whole = mean if rim is None else rim
  speed += (whole - mean)[:, None] * driven
  return np.column_stack([speed, whole / vehicle.gear_ratio]) / vehicle.wheel_radius


def driven_before(lead: Array | None, begun: Callable[[Array, Array], Array]) -> Array | None:
  """How cars were driven before a stretch, (N, 4) in the order of LEAD, given what their sensors said of it.

  Args:
    lead: as the sensors said; None where nobody knows.
    begun: start states, (N, 7), as the cars had them, of what the sensors said of these and of how fast they change.
  """
  if lead is None:
    return None
  speed, change = np.zeros((2, len(lead), len(START)))
  speed[:, _SPEED], change[:, _SPEED] = lead[:, _BEFORE], lead[:, _GAIN]
  out = lead.copy()
  out[:, _BEFORE] = begun(speed, change.copy())[:, _SPEED]
  out[:, _GAIN] = begun(change, np.zeros_like(change))[:, _SPEED]
  return out


def taken(lead: Array, values: Mapping[str, Array], car: CarDimensions) -> Array:
  """The drive before a stretch, (N, 4), with the drive command that its motion took in place of its acceleration.

  a u = J w' + T_c sgn w + (b + c) w, with all that turns and moves in J, rolling without slip.

  Args:
    lead: in the order of LEAD, NaN where nobody knows.
    values: simulator quantities of the cars, see twin/parameters.py.
    car: its measured numbers.
  """
  out, speed = lead.copy(), lead[:, _BEFORE]
  spinning = values["rotor_inertia"] + 4.0 * car.gear_ratio**2 * values["wheel_inertia"]
  inertia = spinning + values["mass"] * (car.gear_ratio * car.wheel_radius) ** 2
  damping = values["motor_damping"] + values["driveline_damping"]
  torque = inertia * lead[:, _GAIN] + values["driveline_friction"] * np.sign(speed) + damping * speed
  out[:, _GAIN] = torque / values["torque_per_volt"]
  return out


def _front_share(vehicle: Vehicle) -> float:
  """Share of the front wheels in what the motor turns at."""
  return float("front" in vehicle.driven_axles) / len(vehicle.driven_axles)
