"""A bench for mechanisms without a simulator: made-up motion, a dictionary as the model, all hooks called."""

import dataclasses

import numpy as np

from qcar_twin.plant import SIGNALS
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.mechanisms.base import CarDimensions, Context, Mechanism, Track

CATALOGUE = catalogue()
CAR = CarDimensions(
  mass=2.7,
  yaw_inertia=0.03,
  cg_to_front=0.125,
  cg_to_rear=0.131,
  track_width=0.17,
  cg_height=0.045,
  wheel_radius=0.033,
  gear_ratio=0.0953668,
  max_steering=0.5236,
  imu_x=0.02,
  imu_y=0.01,
  differential="open",
  duty_supply=8.0,
  switches=True,
)
PERIOD = 0.01
MIRRORED_SIGNALS = ("pose_y", "pose_yaw", "velocity_y", "yaw_rate", "accel_y", "steering_angle")
MIRRORED_QUANTITIES = ("gravity_y", "added_mass_y", "cg_lateral_offset")
SWAP_SIDES = [1, 0, 3, 2]


class BenchModel:
  """The simulator's quantities as plain arrays."""

  def __init__(self, n: int):
    wheel = {
      "cornering_stiffness": 90.0,
      "longitudinal_stiffness": 135.0,
      "friction_coefficient": 0.8,
      "tyre_shape": 1.3,
      "load_exponent": 0.1,
      "relaxation_length": 0.01,
      "longitudinal_relaxation": 0.01,
    }
    car = {
      "gravity_x": 0.0,
      "gravity_y": 0.0,
      "supply_sag": 0.0,
      "driveline_friction": 8.5e-3,
      "driveline_damping": 0.0,
      "torque_per_volt": 0.0272,
      "motor_damping": 7.1e-5,
      "rotor_inertia": 2e-6,
      "wheel_inertia": 6e-5,
      "differential_damping": 0.0,
      "differential_friction": 0.0,
      "servo_time_constant": 0.005,
      "servo_rate": 20.0,
      "steering_hold": 0.0,
      "drive_hold": 0.0,
      "one_way": 0.0,
      "one_way_brake": 0.0,
      "one_way_neutral": 0.0,
      "one_way_weakness": 0.0,
      "one_way_reverse": 0.0,
      "braked_at_first": 0.0,
      "ackermann_fraction": 1.0,
      "added_mass": 0.0,
      "added_mass_x": 0.0,
      "added_mass_y": 0.0,
      "cg_height_offset": 0.0,
      "cg_lateral_offset": 0.0,
    }
    self.values = {k: np.full((n, 4), v) for k, v in wheel.items()} | {k: np.full(n, v) for k, v in car.items()}

  def get(self, quantity: str):
    return self.values[quantity].copy()

  def set(self, quantity: str, value) -> None:
    assert np.shape(value) == self.values[quantity].shape, quantity
    self.values[quantity] = np.array(value)


@dataclasses.dataclass
class Drive:
  """Made-up driving of n cars over T periods: signals (T, n, 10), commands (T, n, 2), history (n, 2)."""

  signals: np.ndarray
  commands: np.ndarray
  history: np.ndarray
  offset: np.ndarray
  car: CarDimensions = CAR

  def rows(self, rows) -> "Drive":
    return Drive(self.signals[:, rows], self.commands[:, rows], self.history[rows], self.offset[rows], self.car)

  def mirrored(self) -> "Drive":
    signals, commands = mirror_signals(self.signals), self.commands * [1.0, -1.0]
    return Drive(signals, commands, self.history, self.offset, dataclasses.replace(self.car, imu_y=-self.car.imu_y))

  def context(self, k: int) -> Context:
    signals, time = self.signals[k], k * PERIOD
    n = len(signals)
    return Context(
      car=self.car,
      period=PERIOD,
      time=time,
      signals=signals,
      commands=self.commands[k],
      history=self.history,
      recording_time=self.offset + time,
      pose=signals[:, :3],
      wheel_angle=self.car.gear_ratio * PERIOD * sum(self.signals[:k, :, SIGNALS.index("motor_speed")], np.zeros(n)),
      torque_per_volt=np.full(n, 0.0272),
      motor_damping=np.full(n, 7.1e-5),
    )

  def track(self) -> Track:
    time = self.offset[:, None] + PERIOD * np.arange(len(self.signals))
    return Track(self.car, PERIOD, np.ascontiguousarray(self.signals.transpose(1, 0, 2)), time)


def wander(rng, steps: int, n: int, size: float):
  """Smooth random signals, (T, n), of a given size."""
  time = PERIOD * np.arange(steps)[:, None, None]
  frequency, phase = rng.uniform(0.3, 2.5, (1, n, 4)), rng.uniform(0, 2 * np.pi, (1, n, 4))
  return size * np.sin(2 * np.pi * frequency * time + phase).sum(-1) / 2.0


def drive(n: int = 5, steps: int = 60, seed: int = 0) -> Drive:
  """Plausible motion of a small car, forward and backward."""
  rng = np.random.default_rng(seed)
  sizes = (1.0, 1.0, 1.0, 1.0, 0.1, 1.5, 1.5, 2.0, 0.0, 0.25)
  signals = np.stack([wander(rng, steps, n, size) for size in sizes], axis=-1)
  signals[..., 3] += 0.8
  signals[..., 8] = signals[..., 3] / CAR.wheel_radius / CAR.gear_ratio
  commands = np.stack([1.0 + wander(rng, steps, n, 1.2), wander(rng, steps, n, 0.25)], axis=-1)
  history = np.stack([rng.uniform(20, 200, n), rng.uniform(50, 600, n)], axis=-1)
  offset = rng.uniform(0, 20, n)
  signals[..., 8] *= 1.0 + wander(rng, steps, n, 0.05)  # wheels that push slip
  return Drive(signals, commands, history, offset)


def still(n: int = 3, steps: int = 5) -> Drive:
  """Everything zero."""
  return Drive(np.zeros((steps, n, 10)), np.zeros((steps, n, 2)), np.zeros((n, 2)), np.zeros(n))


def mirror_signals(signals):
  sign = np.array([-1.0 if name in MIRRORED_SIGNALS else 1.0 for name in SIGNALS])
  return signals * sign


def theta_of(mechanism: Mechanism, share: float = 1.0, n: int = 1):
  """Parameters (n, p) with every amplitude at null + share * typical, inside its bounds; shapes nominal."""
  row = [
    p.nominal if p.null is None else np.clip(p.null + share * (p.typical or 0.0), p.lower, p.upper)
    for p in mechanism.parameters
  ]
  return np.tile(np.array(row), (n, 1))


def run(mechanism: Mechanism, theta, drive: Drive) -> dict[str, np.ndarray]:
  """Every hook over a drive: acting commands (T, n, 2), wrenches (T, n, 3), quantities, measured (n, T, 10)."""
  state = mechanism.initial(theta, drive.context(0))
  acting, pushes, quantities = [], [], []
  for k in range(len(drive.commands)):
    context = drive.context(k)
    acting.append(mechanism.command(theta, context, state, drive.commands[k].copy()))
    pushes.append(mechanism.wrench(theta, context, state))
    model = BenchModel(len(theta))
    mechanism.write_model(theta, context, model)
    quantities.append(model.values)
  out = {"command": np.array(acting), "wrench": np.array(pushes), "measure": mechanism.measure(theta, drive.track())}
  return out | {name: np.array([q[name] for q in quantities]) for name in quantities[0]}


def mirror_results(results: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
  """Results of the mirrored car as the unmirrored one's."""
  out = {}
  for name, value in results.items():
    if name == "command":
      value = value * [1.0, -1.0]
    elif name == "wrench":
      value = value * [1.0, -1.0, -1.0]
    elif name == "measure":
      value = mirror_signals(value)
    elif name in MIRRORED_QUANTITIES:
      value = -value
    elif value.ndim == 3:
      value = value[..., SWAP_SIDES]
    out[name] = value
  return out


def stacked(results: dict[str, np.ndarray]) -> np.ndarray:
  """Everything a mechanism changes, as one vector."""
  return np.concatenate([np.ravel(v) for v in results.values()])


def motion(steps=1, n=1, **signals):
  """A drive with constant or (T,)-shaped signals by name; everything else zero."""
  out = still(n=n, steps=steps)
  for name, value in signals.items():
    out.signals[..., SIGNALS.index(name)] = np.asarray(value, float).reshape(-1, 1)
  return out


def act(name, theta, commands, column, driven=None):
  """What a command (T,) becomes, (T,)."""
  commands = np.asarray(commands, float)
  driven = driven or motion(len(commands))
  driven.commands[..., column] = commands[:, None]
  mechanism, theta = CATALOGUE[name], np.array([theta], float)
  state = mechanism.initial(theta, driven.context(0))
  out = []
  for k in range(len(commands)):
    out.append(mechanism.command(theta, driven.context(k), state, driven.commands[k].copy())[0])
  other = 1 - column
  np.testing.assert_array_equal(np.array(out)[:, other], driven.commands[:, 0, other])
  return np.array(out)[:, column]


def changed(name, theta, driven=None, k=0):
  """Quantities after `write_model` over those before, as differences."""
  driven, mechanism = driven or motion(), CATALOGUE[name]
  before, model = BenchModel(1), BenchModel(1)
  mechanism.write_model(np.array([theta], float), driven.context(k), model)
  return {q: (v - before.values[q])[0] for q, v in model.values.items() if np.any(v != before.values[q])}


def shown(name, theta, track):
  out = CATALOGUE[name].measure(np.array([theta], float), track)
  same = {s: np.array_equal(out[..., i], track.signals[..., i]) for i, s in enumerate(SIGNALS)}
  return {s: out[0, :, SIGNALS.index(s)] for s, kept in same.items() if not kept}
