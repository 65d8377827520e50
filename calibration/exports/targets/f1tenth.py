"""Parameters of f1tenth_gym's single track: the dictionary that its environment takes as `params`.

Names and meaning are those of f1tenth_gym (O'Kelly et al., F1TENTH: an open-source evaluation environment, NeurIPS 2019
Competition track): C_S is a stiffness over load and friction, C = mu C_S F_z per axle.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration.exports import gym_track
from calibration.exports.cars import CarModel
from calibration.exports.numbers import Numbers, matched, single_track_numbers, stays
from calibration.exports.target import Job, Target
from calibration.exports.written import gain_unit, heading, text_lines
from calibration.exports.yaml_numbers import read_numbers, yaml_lines
from qcar_twin.twin.mechanisms.base import Mechanism
from qcar_twin.vehicle.vehicle import GRAVITY, Vehicle

SWITCH_SPEED = 0.5  # m/s, below which f1tenth_gym is kinematic
MATCHED = ("drive_gain", "drive_damping", "drive_friction")
ABOUT = {
  "mu": "-", "C_Sf": "1/rad, front axle", "C_Sr": "1/rad, rear axle", "lf": "m", "lr": "m", "h": "m", "m": "kg",
  "I": "kg m^2", "s_min": "rad", "s_max": "rad", "sv_min": "rad/s", "sv_max": "rad/s", "v_switch": "m/s",
  "a_max": "m/s^2", "v_min": "m/s", "v_max": "m/s", "width": "m", "length": "m",
  "travel_per_radian": "m/rad of the motor", "drive_damping": "1/s, P2",
  "drive_friction": "rad/s^2, P3", "switch_speed": "m/s, kinematic below",
}  # fmt: skip
STRUCTURE = {
  "axles coupled by the drive": {"centre_differential": 1.0},
  "tyres that saturate": {"friction_coefficient": np.inf},
  "slip along the car": {"longitudinal_stiffness": np.inf},
  "relaxation length": {"relaxation_length": 0.0, "longitudinal_relaxation": 0.0},
  "roll and pitch": {"suspension_frequency": np.inf},
}
DRIVE = ("travel_per_radian", "drive_gain", "drive_damping", "drive_friction")


def expresses(mechanism: Mechanism) -> bool:
  """A format of constant numbers holds what is one."""
  return stays(mechanism)


def gym_numbers(job: Job, target: Target, switch_speed: float) -> Numbers:
  """Parameters by f1tenth_gym's names, and the drive line's for which it has none."""
  own, v = single_track_numbers(job.twin, job.theta, job.kept(target)), job.twin.vehicle
  length = v.wheelbase
  mu, loads = own["friction_coefficient"], (own["cg_to_rear"] / length, own["cg_to_front"] / length)
  weight = own["mass"] * GRAVITY
  steering_rate = min(own.get("servo_rate", np.inf), v.max_steering / own["servo_time_constant"])
  return {
    "mu": mu,
    "C_Sf": own["cornering_stiffness_front"] / (mu * weight * loads[0]),
    "C_Sr": own["cornering_stiffness_rear"] / (mu * weight * loads[1]),
    "lf": own["cg_to_front"], "lr": own["cg_to_rear"], "h": own["cg_height"], "m": own["mass"], "I": own["yaw_inertia"],
    "s_min": -v.max_steering, "s_max": v.max_steering, "sv_min": -steering_rate, "sv_max": steering_rate,
    **_limits(own, v),
    "width": v.track_width + 0.9 * v.wheel_radius, "length": length + 2.0 * v.wheel_radius,
    **{name: own[name] for name in DRIVE}, "switch_speed": switch_speed,
  }  # fmt: skip


def _limits(own: Numbers, v: Vehicle) -> Numbers:
  """Largest acceleration, m/s^2, and of a drive whose largest command is known the speeds to which it goes, m/s.

  A voltage or a duty ends at the supply's volts, a current at the largest torque, which limits the acceleration of the
  other drives, too. What is the largest commanded speed or acceleration no twin knows.
  """
  grip, electric = own["friction_coefficient"] * GRAVITY, v.drive in ("voltage", "duty")
  torque = v.max_torque / (own["moved_mass"] * own["travel_per_radian"])
  pull = own["travel_per_radian"] * own["drive_gain"] * v.supply_voltage if electric else torque
  most = min(grip, pull)
  if not electric and (v.drive != "current" or not np.isfinite(pull)):
    return {"a_max": most}
  fastest = pull / own["drive_damping"]
  return {"v_switch": max((pull - most) / own["drive_damping"], 0.0), "a_max": most, "v_min": -fastest,
          "v_max": fastest}  # fmt: skip


def unsaid(car: Numbers) -> list[str]:
  """What a user is told of the limits of speed that a car of `gym_numbers` lacks, a sentence each."""
  if "v_max" in car:
    return []
  return ["v_min, v_max and v_switch are not in it: the largest command of the drive is not known; add the car's own"]


def matched_numbers(job: Job, target: Target, car: Numbers, names: Sequence[str]) -> Numbers:
  """The same nearest to the twin without what the format lacks, so that numbers keep their meaning, where there are
  recordings."""
  recordings = [r for r in job.dataset.recordings if r.role == "identify"] if job.dataset else []
  if not recordings:
    return car
  return matched(job.twin, job.plain(target), job.kept(target), gym_track, car, names, recordings, job.command_shift)[0]


def longest_step(car: Mapping[str, float]) -> float:
  """Longest step of a fourth-order Runge-Kutta above the switching speed, s: it takes a decay rate times it of 2.8."""
  length = car["lf"] + car["lr"]
  rear = car.get("C_Sr", car["C_Sf"])
  front = car["mu"] * car["C_Sf"] * car["m"] * GRAVITY * car["lr"] / length
  rear = car["mu"] * rear * car["m"] * GRAVITY * car["lf"] / length
  turning = (front * car["lf"] ** 2 + rear * car["lr"] ** 2) / (car["I"] * car["switch_speed"])
  return 2.785 / max(turning, (front + rear) / (car["m"] * car["switch_speed"]))


def _write(job: Job, path: Path) -> Sequence[str]:
  car = matched_numbers(job, TARGET, gym_numbers(job, TARGET, SWITCH_SPEED), MATCHED)
  about = ABOUT | {"drive_gain": gain_unit(job.twin.vehicle)}
  lines = [*heading(job, job.lost(TARGET)), "# The last five are the drive line's: a = G R (P1 u - P2 w - P3 sgn w)."]
  text_lines(path, [*lines, *(f"# {said}." for said in unsaid(car)), *yaml_lines(car, about)])
  step = longest_step(car)
  told = f"stable up to a timestep of {1e3 * step:.1f} ms at {SWITCH_SPEED:g} m/s (f1tenth_gym's default is 10 ms)"
  return [told, *unsaid(car)]


def _drives(path: Path, job: Job) -> tuple[CarModel, Mapping[str, object]]:
  return gym_track, read_numbers(path)  # type: ignore[return-value]


TARGET = Target(
  name="f1tenth",
  file="f1tenth.yaml",
  summary="parameters of f1tenth_gym's single track",
  write=_write,
  expresses=expresses,
  drives=_drives,
  structure=STRUCTURE,
)
