"""Plain MJCF that any MuJoCo opens, tyres by MuJoCo's own friction.

Below the friction cone a native contact creeps: its velocity along the ground is the force over c, so the cornering
stiffness c w of a car grows with its speed w. c is chosen so that it is the twin's at one speed: the one of a few that
brings the file's answers nearest to the twin's on the recordings that the twin was fitted to. c = C / w, and MuJoCo's
row gives c = b / R with its damping b and its regularisation R = (1 - d) / d times the contact's inverse mass (MuJoCo
documentation, Computation: constraint model).
"""

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from calibration.exports.cars import CarModel, ModelCars
from calibration.exports.numbers import dead_times, quantities_of, stays, without
from calibration.exports.target import Job, Target
from calibration.exports.written import heading, text_lines
from calibration.fitting.noise_floor import driving_noise
from calibration.fitting.windows import Cut, cut_recordings
from qcar_twin.parameters import Parameter
from qcar_twin.plant import signal_index
from qcar_twin.twin.mechanisms.base import Context, Mechanism, Model
from qcar_twin.vehicle.mjcf import car_spec, knuckle_inertia
from qcar_twin.vehicle.vehicle import WHEELS, Vehicle

Array = NDArray[np.float64]

REFERENCE_SPEED = 0.25  # m/s: without recordings, what serves the bundled sample best (docs/results/exports.md)
_TRIED = (2.0, 1.4, 1.0, 0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08, 0.05)  # m/s
_COMPARED = ("yaw_rate", "accel_x", "accel_y", "motor_speed")
_SECONDS = 30.0  # of driving that the choice is made on
TIMESTEP, PARTS = 0.001, 10  # s, and steps in a control period; at 2 ms wheels tremble, twice as much is felt across
_SETTLES = 2.0  # s, after which the car stands still
_SLOWEST = 0.02  # m/s, at which the twin still has tyres
IMPEDANCE = 0.95  # MuJoCo's own upper value, at which its friction chatters least
_OWN = (
  "steering_offset", "steering_gain_error", "command_delay", "steering_delay", "steering_lag", "drive_delay",
  "floor_slope",
)  # fmt: skip
_PLAIN = (
  "torque_per_volt", "torque_per_ampere", "torque_per_speed", "torque_per_acceleration", "motor_damping",
  "driveline_friction", "rotor_inertia", "wheel_inertia", "servo_time_constant", "servo_inertia", "servo_rate",
  "ackermann_fraction", "yaw_inertia", "centre_differential", "max_torque", "suspension_frequency",
)  # fmt: skip


def _expresses(mechanism: Mechanism) -> bool:
  return mechanism.name in _OWN or stays(mechanism)


def fitted_vehicle(job: Job) -> tuple[Vehicle, dict[str, Array]]:
  """The car with the twin's fitted numbers in its description, and its quantities."""
  v, q = job.twin.vehicle, quantities_of(job.twin, job.theta, job.kept(TARGET))
  values = {name: float(q[name]) for name in _PLAIN if name in q and hasattr(v, name)}
  values[v.motor.gain] = float(q["torque_per_volt"])
  mass = float(q["mass"] + q["added_mass"])
  front = float(q["cg_to_front"] - q["added_mass"] * q["added_mass_x"] / mass)
  values |= {"mass": mass, "cg_to_front": front, "cg_to_rear": v.wheelbase - front}
  values |= {"friction_coefficient": float(np.mean(q["friction_coefficient"]))}
  return dataclasses.replace(v, **values), q


def _speed(job: Job, path: Path) -> float:
  """The speed at which c is taken that brings the file's answers nearest to the twin's, m/s."""
  recordings = [r for r in job.dataset.recordings if r.role == "identify"] if job.dataset else []
  if not recordings:
    return REFERENCE_SPEED
  cut = Cut(length=2.0, warm_up=0.0, most=_SECONDS, evenly=True, command_shift=job.command_shift)
  segments = cut_recordings(recordings, job.twin.vehicle, cut).segments
  twin, theta = without(job.twin, job.theta, job.kept(TARGET))
  wanted, noise = twin.rollout(theta, segments).signals[0], driving_noise(recordings)
  costs = []
  for speed in _TRIED:
    _write_at(job, path, speed)
    twin, theta = without(job.twin, job.theta, [])
    model, car = _drives(path, job)
    shown = twin.with_engine(lambda size, m=model, c=car: ModelCars(m, c, size)).rollout(theta, segments).signals[0]
    wrong = {name: shown[..., signal_index(name)] - wanted[..., signal_index(name)] for name in _COMPARED}
    costs.append(sum(np.mean(np.square(w / noise.get(name, 1.0))) for name, w in wrong.items()))
  return _TRIED[int(np.argmin(costs))]


def _write(job: Job, path: Path) -> Sequence[str]:
  speed = _speed(job, path)
  about = _write_at(job, path, speed)
  return [about, f"tyres are MuJoCo's own friction; timestep {TIMESTEP:g} s"]


def _write_at(job: Job, path: Path, speed: float) -> str:
  """The file with the twin's cornering stiffness at a speed [m/s]; a sentence on it."""
  (car, q), values = fitted_vehicle(job), job.twin.parameters.named(job.theta)
  spec = car_spec(car, "native", TIMESTEP, looks=True)
  body = spec.body("chassis")  # its CG moves, not its frame: hull, sites and cameras stay where the car has them
  body.ipos[2] += float(q["cg_height_offset"]) * car.mass / body.mass
  spec.option.gravity[:2] = [float(q["gravity_x"]), float(q["gravity_y"])]
  inverse_mass = {w: spec.compile().body(w).invweight0[0] for w in WHEELS}
  for place, wheel in enumerate(WHEELS):
    creep = float(q["cornering_stiffness"][place]) / speed  # N s/m
    row = creep * (1.0 - IMPEDANCE) / IMPEDANCE * inverse_mass[wheel]
    mu = float(q["friction_coefficient"][place])
    pair = spec.add_pair(name=wheel, geomname1="floor", geomname2=wheel, condim=3, friction=[mu, mu, 0.005, 1e-4, 1e-4])
    pair.solref, pair.solimp = [2.0 * TIMESTEP, 1.0], [IMPEDANCE, IMPEDANCE, 0.001, 0.5, 2.0]
    pair.solreffriction = [-1e-9, -row * IMPEDANCE]
  _servo(spec, car)
  _effects(spec, job, {m.name for m in job.kept(TARGET)}, values)
  spec.compile()
  text = spec.to_xml().split("\n")
  comment = [re.sub("--+", "-", line.removeprefix("# ")) for line in heading(job, job.lost(TARGET))]
  about = f"Cornering stiffness is the twin's at {speed:.2f} m/s; native friction makes it grow with speed."
  text_lines(path, ["<!-- " + "\n     ".join([*comment, about]) + " -->", *text])
  return about


def _servo(spec: mujoco.MjSpec, car: Vehicle) -> None:
  """A servo of second order as the road wheels' own spring and damper: J = q tau^2 k, d = tau k.

  One too fast for the explicit steps, or limited in its rate, stays a filter of first order with the same lag.
  """
  lag, q = car.servo_time_constant, car.servo_inertia
  if q * lag < 2.0 * TIMESTEP or math.isfinite(car.servo_rate):
    return
  servo, inertia = spec.actuator("steering"), knuckle_inertia(car)
  stiffness = 2.0 * inertia / (q * lag**2)  # of two wheels
  servo.dynprm[0], servo.gainprm[0], servo.biasprm[1] = 0.0, stiffness, -stiffness
  servo.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
  for wheel in WHEELS[:2]:
    spec.joint(f"{wheel}_steering").damping[0] = inertia / (q * lag)


def _effects(spec: mujoco.MjSpec, job: Job, kept: set[str], values: Mapping[str, float]) -> None:
  """Effects of the commands that actuators have a place for."""
  servo, motor = spec.actuator("steering"), spec.actuator("motor")
  stiffness = servo.gainprm[0]
  if "steering_lag" in kept:
    servo.dynprm[0] += values["steering_lag"]
  if "steering_gain_error" in kept:
    servo.gainprm[0] *= 1.0 + values["steering_gain_error"]
  if "steering_offset" in kept:
    servo.biasprm[0] += stiffness * values["steering_offset"]
  late = dead_times(kept, values)
  for actuator, name in ((servo, "steering_delay"), (motor, "drive_delay")):
    if late[name] > 0.0:
      actuator.delay, actuator.nsample = late[name], math.ceil(late[name] / TIMESTEP) + 2


def _opened(path: Path) -> mujoco.MjModel:
  return mujoco.MjModel.from_xml_path(str(path))


class PlainFriction(Mechanism):
  """The file's friction in the twin: its stiffness grows with speed, C = c w along and across, c of each wheel."""

  name = "plain_friction"
  subsystem = "tyre"
  stage = "contact"
  varies = True
  parameters = (Parameter("plain_friction", 1.0, 0.0, 1.0, "-", "on", null=0.0),)

  def __init__(self, model: mujoco.MjModel):
    row = model.pair_solreffriction[[model.pair(wheel).id for wheel in WHEELS], 1] / -IMPEDANCE
    weight = np.array([model.body(wheel).invweight0[0] for wheel in WHEELS])
    self._creep = row / weight * IMPEDANCE / (1.0 - IMPEDANCE)  # N s/m, as written

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    speed = np.hypot(context.signal("velocity_x"), context.signal("velocity_y"))
    for quantity in ("cornering_stiffness", "longitudinal_stiffness"):
      model.set(quantity, self._creep * np.maximum(speed, _SLOWEST)[:, None])


class PlainCars:
  """Cars of one MJCF in plain MuJoCo, one after the other; their number is the state."""

  def __init__(self, path: Path):
    self.model = _opened(path)
    self._data: list[mujoco.MjData] = []
    self._yaw = np.zeros(0)
    self._rest = self._settled()

  def _settled(self) -> float:
    """Height at which the car stands, m."""
    data = mujoco.MjData(self.model)
    mujoco.mj_step(self.model, data, round(_SETTLES / self.model.opt.timestep))
    return float(data.joint("chassis").qpos[2])

  def at_start(self, car: Any, start: Array, command: Array) -> Array:
    self._data, self._yaw = [mujoco.MjData(self.model) for _ in start], start[:, 2].copy()
    for data, (x, y, yaw, ahead, aside, rate, angle) in zip(self._data, start, strict=True):
      body, cosine, sine = data.joint("chassis"), np.cos(yaw), np.sin(yaw)
      body.qpos[:3] = [x, y, self._rest]
      body.qpos[3:] = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
      body.qvel[:2] = [cosine * ahead - sine * aside, sine * ahead + cosine * aside]
      body.qvel[5] = rate
      for wheel in WHEELS:
        radius = self.model.geom(wheel).size[0]
        data.joint(f"{wheel}_spin").qvel[:] = (ahead - rate * self.model.body(wheel).pos[1]) / radius
      data.joint("motor").qvel[:] = ahead / car["travel_per_radian"]
      for wheel in WHEELS[:2]:
        data.joint(f"{wheel}_steering").qpos[:] = angle
      data.act[-1:] = angle
    return np.arange(len(start), dtype=np.float64)

  def motion(self, x: Array) -> Array:
    rows = []
    for i in x.astype(int):
      data = self._data[i]
      body = data.joint("chassis")
      yaw, (vx, vy) = self._yaw[i], body.qvel[:2]
      cosine, sine = np.cos(yaw), np.sin(yaw)
      rows.append([*body.qpos[:2], yaw, cosine * vx + sine * vy, cosine * vy - sine * vx, body.qvel[5]])
    return np.array(rows)

  def step(self, x: Array, u: Array, car: Any) -> tuple[Array, Array]:
    shown = []
    for i, command in zip(x.astype(int), u, strict=True):
      data = self._data[i]
      data.actuator("motor").ctrl, data.actuator("steering").ctrl = command
      mujoco.mj_step(self.model, data, PARTS)
      w, _, _, z = data.joint("chassis").qpos[3:]
      yaw = 2.0 * np.arctan2(z, w)
      self._yaw[i] += np.pi - np.mod(np.pi - (yaw - self._yaw[i]), 2.0 * np.pi)
      felt, gyro = data.sensor("accelerometer").data, data.sensor("gyro").data
      angle = float(data.ten("steering").length[0])
      shown.append([gyro[2], felt[0], felt[1], data.sensor("encoder").data[0], angle])
    return x, np.array(shown)


def _drives(path: Path, job: Job) -> tuple[CarModel, Mapping[str, object]]:
  v = job.twin.vehicle
  return PlainCars(path), {"travel_per_radian": v.gear_ratio * v.wheel_radius}


TARGET = Target(
  name="mjcf",
  file="car.xml",
  summary="plain MJCF for any MuJoCo, with native friction",
  write=_write,
  expresses=_expresses,
  drives=_drives,
  structure={"relaxation length": {"relaxation_length": 0.0, "longitudinal_relaxation": 0.0}},
  instead={"tyres whose stiffness is the same at any speed": lambda path: PlainFriction(_opened(path))},
)
