"""Bicycle: the paper's identified model as a `Plant`, the baseline the twin is checked against.

Five parameters are identified (P1, P2, P3, C_f, C_r), the rest of the car is measured. The equations
are in `single_track`; here they get names, a vehicle, and the ten signals every plant answers.

Signals from the state [X, Y, v, psi, beta, r]: v_x = v cos(beta), v_y = v sin(beta), motor speed
v / (G R_w), and the specific force at the IMU,
  a_x = v' cos(beta) - v (beta' + r) sin(beta),  a_y = v' sin(beta) + v (beta' + r) cos(beta),
carried to the IMU's place by `transport_acceleration`. A signal row is what is measured just before the
next command acts. The model has no servo: the steering angle is the command, up to the steering's end.

The drive command of a voltage-driven car is a voltage; of another car it is what its drive takes (duty, current,
speed), and P1 is per unit of that. A limit of the motor's torque is not in the model.

`TurningLosses` is an extension the paper does not have; it is off unless asked for.
"""

import dataclasses
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin import kinematics
from qcar_twin.bicycle import single_track
from qcar_twin.bicycle.single_track import SingleTrackCar, State
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.plant import SIGNALS, START, Prediction, Segments
from qcar_twin.vehicle.drive import DRIVES, Drive
from qcar_twin.vehicle.similarity import AS_THE_QCAR, Similarity

Array = NDArray[np.float64]

_AT_ONCE = 20_000  # periods of all cars whose transitions are computed side by side: some tens of MB

PARAMETERS = ParameterSet(
  (
    Parameter("drive_gain", 850.0, 1.0, 1e5, "rad/s^2/V", "P1", description="motor acceleration per volt"),
    Parameter("drive_damping", 2.5, 0.05, 200.0, "1/s", "P2", description="back-EMF and viscous friction"),
    Parameter("drive_friction", 120.0, 0.0, 1e5, "rad/s^2", "P3", null=0.0, description="Coulomb friction"),
    Parameter("cornering_stiffness_front", 180.0, 1.0, 2e4, "N/rad", "C_f", description="front axle"),
    Parameter("cornering_stiffness_rear", 180.0, 1.0, 2e4, "N/rad", "C_r", description="rear axle"),
  )
)


def parameters_of(drive: Drive, similarity: Similarity = AS_THE_QCAR) -> ParameterSet:
  """The five parameters for a kind of drive command: P1 is per unit of it, P1 and P2 begin at usual values.

  Stiffnesses and their bounds go by the car's similarity, as forces do.
  """
  known = PARAMETERS
  if similarity.length != 1.0:
    per_radian = {name: PARAMETERS[name] for name in PARAMETERS.names if name.startswith("cornering_stiffness")}
    known = known.replace(**{name: similarity.carried(p, "N") for name, p in per_radian.items()})
  if drive == DRIVES["voltage"]:
    return known
  p1, p2 = (known[name] for name in ("drive_gain", "drive_damping"))
  gain, damping = drive.usual
  return known.replace(
    drive_gain=dataclasses.replace(
      p1, nominal=gain, unit=f"rad/s^2/({drive.unit})", description="motor acceleration per unit of the drive command"
    ),
    drive_damping=dataclasses.replace(
      p2, nominal=damping, lower=min(p2.lower, 0.02 * damping), description="all that brakes with the motor's speed"
    ),
  )


class MeasuredCar(Protocol):
  """What the bicycle needs of a vehicle, in SI units; `Vehicle` has it."""

  @property
  def mass(self) -> float: ...
  @property
  def yaw_inertia(self) -> float: ...
  @property
  def cg_to_front(self) -> float: ...
  @property
  def cg_to_rear(self) -> float: ...
  @property
  def wheel_radius(self) -> float: ...
  @property
  def gear_ratio(self) -> float: ...  # wheel speed / motor speed
  @property
  def max_steering(self) -> float: ...
  @property
  def imu_x(self) -> float: ...
  @property
  def imu_y(self) -> float: ...


def drive_of(vehicle: MeasuredCar) -> Drive:
  """What a car's motor is commanded with; a voltage where its description says nothing of it."""
  return getattr(vehicle, "motor", DRIVES["voltage"])


@dataclasses.dataclass(frozen=True)
class TurningLosses:
  """What driven front wheels, coupled to the rear ones without a centre differential, take in a turn.

  Their path is longer by 1 / cos(delta): they are held back, scrub, steer less and brake. To second order
  in the angle, delta_effective = delta (1 - steering delta^2) and P3 + drag delta^2. Zero is the paper's model.

  Attributes:
    steering: 1/rad^2.  drag: rad/s^2 per rad^2, motor side.
  """

  steering: float = 0.0
  drag: float = 0.0


class Bicycle:
  """The identified single-track model; satisfies `Plant`.

  Args:
    vehicle: measured numbers of the car.
    period: control period, s.
    losses: extension for large steering angles; none in the paper.
  """

  def __init__(self, vehicle: MeasuredCar, period: float = 0.01, losses: TurningLosses = TurningLosses()):
    self.vehicle = vehicle
    self.period = period
    self.losses = losses
    self.parameters = parameters_of(drive_of(vehicle), Similarity.of(vehicle.cg_to_front + vehicle.cg_to_rear))

  def __repr__(self) -> str:
    return f"Bicycle(period={self.period:g} s)\n{self.parameters!r}"

  def car(self, theta: Array) -> SingleTrackCar:
    """Numbers of the equations for parameters (..., 5); scalars or arrays (...)."""
    theta = np.asarray(theta, dtype=np.float64)
    if theta.shape[-1:] != (len(self.parameters),):
      raise ValueError(f"expected {len(self.parameters)} parameters {self.parameters.names}, got shape {theta.shape}")
    vehicle = self.vehicle
    return SingleTrackCar(
      *np.moveaxis(theta, -1, 0),
      mass=vehicle.mass,
      yaw_inertia=vehicle.yaw_inertia,
      cg_to_front=vehicle.cg_to_front,
      cg_to_rear=vehicle.cg_to_rear,
      rolling_radius=kinematics.rolling_radius(vehicle),
    )

  def begin(self, theta: Array, start: Array) -> "BicycleSimulation":
    """N cars with parameters (N, 5) at states (N, 7)."""
    return BicycleSimulation(self, np.atleast_2d(theta), np.atleast_2d(start))

  def rollout(self, theta: Array, segments: Segments) -> Prediction:
    """Parameters (n, 5) or (5,) over all segments."""
    if not np.isclose(segments.period, self.period):
      raise ValueError(f"segments have a period of {segments.period:g} s, the bicycle {self.period:g} s; resample them")
    theta, size = np.atleast_2d(np.asarray(theta, dtype=np.float64)), len(segments)
    cars = self.begin(np.repeat(theta, size, axis=0), np.tile(segments.start, (len(theta), 1)))
    commands = np.tile(segments.commands, (len(theta), 1, 1)).swapaxes(0, 1)  # (T, n * S, 2)
    several = max(1, _AT_ONCE // commands.shape[1])
    signals = [cars.signals[None], *(cars.drive(commands[k : k + several]) for k in range(0, len(commands), several))]
    by_car = np.concatenate(signals).swapaxes(0, 1)
    return Prediction(by_car.reshape(len(theta), size, len(commands) + 1, len(SIGNALS)), segments.period)


class BicycleSimulation:
  """N single-track cars under way.

  Attributes:
    state: (N, 6), see `single_track.State`.  signals: (N, 10), see `plant.SIGNALS`.
  """

  def __init__(self, bicycle: Bicycle, theta: Array, start: Array):
    if start.shape != (len(theta), len(START)):
      raise ValueError(f"start must be ({len(theta)}, {len(START)}), got {start.shape}")
    self._bicycle = bicycle
    self._car = bicycle.car(theta)
    self.state = initial_state(start, self._car)
    steering = start[:, START.index("steering_angle")]
    effective, car = self._losses(steering)
    coasting = np.stack([_holding_command(self.state, car), effective], axis=-1)
    self.signals = signals(self.state, coasting, steering, car, bicycle.vehicle)

  def step(self, commands: Array) -> Array:
    """Hold drive command [its unit] and steering command [rad], (N, 2), for one period; signals after it, (N, 10)."""
    return self.drive(np.asarray(commands)[None])[0]

  def drive(self, commands: Array) -> Array:
    """Hold commands, (T, N, 2), for a period each; signals after every period, (T, N, 10)."""
    limit = self._bicycle.vehicle.max_steering
    steering = np.clip(commands[..., 1], -limit, limit)
    effective, car = self._losses(steering)
    applied = np.stack([commands[..., 0], effective], axis=-1)
    states = single_track.steps(self.state, applied, self._bicycle.period, car)
    driven = signals(states, applied, steering, car, self._bicycle.vehicle)
    self.state, self.signals = states[-1], driven[-1]
    return driven

  def _losses(self, steering: Array) -> tuple[Array, SingleTrackCar]:
    """Effective steering angle [rad] (..., N), and the car with the drag of the turn."""
    losses, squared = self._bicycle.losses, np.square(steering)
    if losses == TurningLosses():
      return steering, self._car
    car = dataclasses.replace(self._car, drive_friction=self._car.drive_friction + losses.drag * squared)
    return steering * (1.0 - losses.steering * squared), car


def initial_state(start: Array, car: SingleTrackCar) -> Array:
  """State (N, 6) of a start (N, 7); a car at rest has the sideslip angle its wheels would roll at."""
  x, y, yaw, velocity_x, velocity_y, yaw_rate, steering = start.T
  speed = np.hypot(velocity_x, velocity_y) * np.where(velocity_x < 0.0, -1.0, 1.0)
  rolling = single_track.no_slip_motion(speed, steering, car)[..., 0]
  sideslip = np.where(speed == 0.0, rolling, kinematics.sideslip_angle(velocity_x, velocity_y))
  return np.stack([x, y, speed, yaw, sideslip, yaw_rate], axis=-1)


def _holding_command(state: Array, car: SingleTrackCar) -> Array:
  """Drive command, in its unit, that holds the present speed: (P2 omega + P3 sgn(omega)) / P1."""
  motor_speed = state[:, State.SPEED] / car.rolling_radius
  return (car.drive_damping * motor_speed + car.drive_friction * np.sign(motor_speed)) / np.asarray(car.drive_gain)


def signals(state: Array, commands: Array, steering: Array, car: SingleTrackCar, vehicle: MeasuredCar) -> Array:
  """The ten signals (..., 10) of states (..., 6) under (..., 2) drive commands and effective angles, rad; steering
  angles (...), rad."""
  rates = single_track.derivative(state, commands, car)
  speed, sideslip, yaw_rate = state[..., State.SPEED], state[..., State.SIDESLIP_ANGLE], state[..., State.YAW_RATE]
  along = rates[..., State.SPEED]
  across = speed * (rates[..., State.SIDESLIP_ANGLE] + yaw_rate)
  accel = kinematics.body_to_world(sideslip, along, across)  # from the path's frame into the body's
  imu = kinematics.transport_acceleration(*accel, yaw_rate, rates[..., State.YAW_RATE], vehicle.imu_x, vehicle.imu_y)
  named = {
    "pose_x": state[..., State.POSE_X],
    "pose_y": state[..., State.POSE_Y],
    "pose_yaw": state[..., State.POSE_YAW],
    "velocity_x": speed * np.cos(sideslip),
    "velocity_y": speed * np.sin(sideslip),
    "yaw_rate": yaw_rate,
    "accel_x": imu[0],
    "accel_y": imu[1],
    "motor_speed": speed / car.rolling_radius,
    "steering_angle": steering,
  }
  return np.stack(np.broadcast_arrays(*(named[name] for name in SIGNALS)), axis=-1)
