"""The single track's numbers from a twin: what its quantities say, then matched to what the twin does.

A single track has no body that rolls and no wheel of its own, so the same number means a little less in it. Where a
data set is at hand, those of MATCHED are therefore multiplied by factors that bring its answers nearest to the twin's
(never to the car's) on the recordings that the twin was fitted to.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.exports.cars import CarModel, ModelCars
from calibration.fitting.noise_floor import driving_noise
from calibration.fitting.windows import Cut, cut_recordings
from qcar_twin.kinematics import rolling_radius
from qcar_twin.plant import START, signal_index
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.mechanisms.base import Mechanism
from qcar_twin.twin.mechanisms.elements import second_order
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.mjcf import FASTEST_SERVO, centre_damping
from qcar_twin.vehicle.vehicle import GRAVITY

Array = NDArray[np.float64]
Numbers = dict[str, Any]

EXPRESSED = (
  "steering_offset", "steering_gain_error", "steering_asymmetry", "command_delay", "steering_delay", "steering_lag",
  "drive_delay", "drive_lag", "battery_sag", "quadratic_drag", "side_force",
)  # fmt: skip
"""Effects that the single track's file computes by the mechanism's own equation."""
MATCHED = (
  "drive_gain", "drive_damping", "drive_friction", "cornering_stiffness_front", "cornering_stiffness_rear",
  "longitudinal_stiffness_front", "longitudinal_stiffness_rear", "friction_coefficient", "servo_time_constant",
  "roll_gain", "pitch_gain",
)  # fmt: skip
_CHANNELS = ("yaw_rate", "accel_x", "accel_y", "motor_speed")
_ROUNDS, _MOVE, _REACH = 5, 1e-3, 0.5  # of Gauss-Newton; share for slopes; most change of a logarithm in a round
# what needs two wheels on an axle, a slope, or a speed controller that switches with the motor's speed
_WITHOUT = ("cg_lateral_offset", "differential_lock", "floor_slope", "drive_one_way")
_PRIOR = 1.0  # standard deviation of a factor's logarithm: what the driving does not show stays where it is
_SECONDS = 90.0  # of driving that is matched at most
# N s/m, damping between the axles' rims that stands for an open differential's 0: even a tyre that spins holds its axle
# by a hundred thousand times as much, and a file of numbers takes no infinite compliance
_OPEN = 1e-6


def without(twin: Twin, theta: Array, kept: Sequence[Mechanism]) -> tuple[Twin, Array]:
  """The twin with some of its mechanisms, and its parameters (P,) without those of the others.

  A mechanism that it has not has its nominal parameters.
  """
  other, values = twin.with_mechanisms(kept), twin.parameters.named(theta)
  nominal = other.parameters.named(other.parameters.nominal)
  return other, other.parameters.vector({name: values.get(name, nominal[name]) for name in nominal})


def constant(mechanism: Mechanism) -> bool:
  """Whether an effect is a number of the simulator that never changes."""
  return mechanism.stage == "contact" and not mechanism.varies


def stays(mechanism: Mechanism) -> bool:
  """Whether it is one that a single track has, too, and takes over."""
  return constant(mechanism) and mechanism.name not in _WITHOUT


def quantities_of(twin: Twin, theta: Array, kept: Sequence[Mechanism]) -> dict[str, Array]:
  """Quantities of one car with its contact effects written in, each (), (4,) or (1,)."""
  held: list[ModelCars] = []

  def made(size: int) -> ModelCars:
    held.append(ModelCars(None, None, size))
    return held[0]

  part, values = without(twin, theta, [m for m in kept if constant(m)])
  part.with_engine(made).begin(values[None], np.zeros((1, len(START))))
  return {name: np.asarray(value)[0] for name, value in held[0].values.items()}


def single_track_numbers(twin: Twin, theta: Array, kept: Sequence[Mechanism]) -> Numbers:
  """Numbers of `single_track` by what the twin's quantities mean; `kept` are the effects that it is to express."""
  q, v = quantities_of(twin, theta, kept), twin.vehicle
  mass, ahead = q["mass"] + q["added_mass"], q["added_mass"] * q["added_mass_x"] / (q["mass"] + q["added_mass"])
  travel, front = rolling_radius(v), q["cg_to_front"] - ahead
  height = v.cg_height + q["cg_height_offset"]
  moved = mass + (q["rotor_inertia"] / v.gear_ratio**2 + 4.0 * q["wheel_inertia"]) / v.wheel_radius**2
  inertia = moved * travel**2
  spring = 2.0 * mass / 4.0 * (2.0 * np.pi * q["suspension_frequency"]) ** 2
  arm = mass * GRAVITY * height
  axles = len(v.driven_axles)
  share = 0.5 if axles == 2 else 1.0 if "front" in v.driven_axles else 0.0
  damping = float(centre_damping(q.get("centre_differential", 0.0), v.similarity))
  numbers: Numbers = {
    "mass": mass, "yaw_inertia": q["yaw_inertia"] + q["added_mass"] * q["added_mass_x"] ** 2 * q["mass"] / mass,
    "cg_to_front": front, "cg_to_rear": v.wheelbase - front, "cg_height": height,
    "travel_per_radian": travel, "moved_mass": moved,
    "shaft_mass": (q["rotor_inertia"] / v.gear_ratio**2 + 2.0 * axles * q["wheel_inertia"]) / v.wheel_radius**2,
    "drive_gain": q["torque_per_volt"] / inertia,
    "drive_damping": (q["motor_damping"] + q["driveline_damping"]) / inertia,
    "drive_friction": q["driveline_friction"] / inertia,
    "drive_front": share,
    "centre_compliance": 1.0 / max(damping / v.wheel_radius**2, _OPEN),
    "longitudinal_stiffness_front": float(np.sum(q["longitudinal_stiffness"][:2])) if share > 0.0 else 0.0,
    "longitudinal_stiffness_rear": float(np.sum(q["longitudinal_stiffness"][2:])) if share < 1.0 else 0.0,
    "cornering_stiffness_front": float(np.sum(q["cornering_stiffness"][:2])),
    "cornering_stiffness_rear": float(np.sum(q["cornering_stiffness"][2:])),
    "friction_coefficient": float(np.mean(q["friction_coefficient"])),
    "tyre_shape": float(np.mean(q["tyre_shape"])), "load_exponent": float(np.mean(q["load_exponent"])),
    "relaxation_length": float(np.mean(q["relaxation_length"])),
    "servo_time_constant": max(float(q["servo_time_constant"]), 1e-4), "servo_inertia": q["servo_inertia"],
    "max_steering": v.max_steering, "imu_x": v.imu_x, "imu_y": v.imu_y,
    "roll_gain": 1.0 + arm / (spring * v.track_width**2 / 2.0),
    "pitch_gain": 1.0 + arm / (spring * v.wheelbase**2 / 2.0),
  }  # fmt: skip
  if q["servo_rate"] < FASTEST_SERVO:
    numbers["servo_rate"] = q["servo_rate"]
  return {name: float(value) for name, value in numbers.items()} | _effects(twin, theta, kept)


def _effects(twin: Twin, theta: Array, kept: Sequence[Mechanism]) -> Numbers:
  """Parameters of the effects that the single track computes itself."""
  values, made = twin.parameters.named(theta), {}
  for mechanism in kept:
    if mechanism.name in EXPRESSED:
      own = {p.name: float(values[p.name]) for p in mechanism.parameters if p.name != "command_delay"}
      if mechanism.name in ("steering_lag", "drive_lag"):
        lag = second_order(np.array([own[mechanism.name]]), np.array([own[f"{mechanism.name}_inertia"]]), twin.period)
        own[f"{mechanism.name}_transition"] = tuple(float(lag[k][0]) for k in "abcd")  # type: ignore[assignment]
        own[f"{mechanism.name}_inertia"] = float(lag["inertia"][0])
      made |= own
  return made | {name: late for name, late in dead_times({m.name for m in kept}, values).items() if late}


def dead_times(kept: Collection[str], values: Mapping[str, float]) -> dict[str, float]:
  """Between a command and what acts, s, of the drive and of the steering: what both share counts in each."""
  late = lambda name: float(values[name]) if name in kept else 0.0
  return {name: late(name) + late("command_delay") for name in ("drive_delay", "steering_delay")}


def matched(
  twin: Twin, theta: Array, kept: Sequence[Mechanism], model: CarModel, car: Numbers, names: Sequence[str],
  recordings: Sequence[Recording], command_shift: int,
) -> tuple[Numbers, dict[str, float]]:  # fmt: skip
  """The car with factors on `names` that bring the model nearest to the twin with `kept` effects on recordings.

  Least squares over yaw rate, accelerations and motor speed, each over its sensor's noise while driving.

  Returns:
    the numbers; the factors by name.
  """
  names = [name for name in names if car.get(name, 0.0) != 0.0]
  cut = Cut(length=2.0, warm_up=0.0, most=_SECONDS, evenly=True, command_shift=command_shift)
  segments = cut_recordings(recordings, twin.vehicle, cut).segments
  other, values = without(twin, theta, kept)
  shown = other.rollout(values, segments).signals[0]
  start = shown[:, 0, [signal_index(name) for name in START]]  # as the twin takes it: with what its sensors make of it
  wanted = np.stack([shown[..., 1:, signal_index(name)] for name in _CHANNELS])  # (4, S, T)
  inside = np.arange(wanted.shape[2]) < segments.steps[:, None]
  scale = _scale(recordings, wanted[:, inside])[:, None, None] * np.sqrt(inside.sum())
  commands = segments.commands * [twin.vehicle.command_scale, 1.0]

  def residual(factors: Array) -> Array:
    varied = car | {n: car[n] * np.exp(factors[:, i, None]) for i, n in enumerate(names)}
    answer = np.moveaxis(driven(model, varied, start, commands), (0, 3), (3, 1))[:, : len(_CHANNELS)]
    return ((answer - wanted) / scale * inside).reshape(len(factors), -1)

  at = np.zeros(len(names))
  here = residual(at[None])[0]
  for _ in range(_ROUNDS):
    slopes = ((residual(at + _MOVE * np.eye(len(names))) - here) / _MOVE).T
    strength = float(here @ here) / (0.5 * inside.sum())  # of the prior: a factor's e counts as one residual
    curvature = slopes.T @ slopes + strength / _PRIOR**2 * np.eye(len(names))
    move = np.linalg.solve(curvature, -(slopes.T @ here + strength / _PRIOR**2 * at))
    move *= min(1.0, _REACH / np.abs(move).max())
    trials = residual(at + move * np.array([[1.0], [0.5], [0.25]]))
    costs = np.sum(np.nan_to_num(trials, nan=1e6) ** 2, axis=1)
    best = int(np.argmin(costs))
    if costs[best] >= here @ here:
      break
    at, here = at + move * (1.0, 0.5, 0.25)[best], trials[best]
  factors = {name: float(np.exp(value)) for name, value in zip(names, at, strict=True)}
  return car | {name: float(car[name] * factor) for name, factor in factors.items()}, factors


def _scale(recordings: Sequence[Recording], shown: Array) -> Array:
  """Noise of the compared channels while driving, (4,); a hundredth of what is shown where nobody logged one."""
  noise, spread = driving_noise(recordings), shown.std(axis=1)
  return np.array(
    [max(noise.get(n, 0.0), 1e-6) if n in noise else 0.01 * s for n, s in zip(_CHANNELS, spread, strict=True)]
  )


def driven(model: CarModel, car: Numbers, start: Array, commands: Array) -> Array:
  """What sensors show, (T, n, S, 5), of cars whose numbers are () or (n, 1), from (S, 7), under commands (S, T, 2)."""
  x = model.at_start(car, start, commands[:, 0])
  shown = []
  for k in range(commands.shape[1]):
    x, sensed = model.step(x, commands[:, k], car)
    shown.append(sensed if sensed.ndim == 3 else sensed[None])
  return np.stack(shown)
