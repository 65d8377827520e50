"""CommonRoad's vehicle parameters: one file for its single track (ST) and its drift model (STD).

Both axles share one tyre there, so the balance of the two cornering stiffnesses has no place but the centre of gravity.
ST takes C_S = -p_ky1 / p_dy1 from it; STD a Magic Formula, here with p_c the shape and no curvature and no shifts, so
that it is Pacejka's sine law, and combined slip without weights.
Source: Althoff and Wuersching, CommonRoad: Vehicle Models, 2020, sec. 7 and 8.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration.exports import gym_track
from calibration.exports.cars import CarModel
from calibration.exports.numbers import quantities_of
from calibration.exports.target import Job, Target
from calibration.exports.targets.f1tenth import (
  ABOUT,
  DRIVE,
  STRUCTURE,
  expresses,
  gym_numbers,
  matched_numbers,
  unsaid,
)
from calibration.exports.written import gain_unit, heading, text_lines
from calibration.exports.yaml_numbers import extra_lines, read_numbers, yaml_lines
from qcar_twin.vehicle.vehicle import GRAVITY

SWITCH_SPEED = 0.1  # m/s, below which ST is kinematic
MATCHED = ("drive_gain", "drive_damping", "drive_friction")
_TYRE = (
  "p_cx1", "p_dx1", "p_dx3", "p_ex1", "p_kx1", "p_hx1", "p_vx1", "r_bx1", "r_bx2", "r_cx1", "r_ex1", "r_hx1", "p_cy1",
  "p_dy1", "p_dy3", "p_ey1", "p_ky1", "p_hy1", "p_hy3", "p_vy1", "p_vy3", "r_by1", "r_by2", "r_by3", "r_cy1", "r_ey1",
  "r_hy1", "r_vy1", "r_vy3", "r_vy4", "r_vy5", "r_vy6",
)  # fmt: skip
_TYRE_KEY = "tyre".replace("y", "i")  # as the format spells it
_ABOUT = ABOUT | {
  "l": "m", "w": "m", "a": "m, centre of gravity to front axle", "b": "m, to rear axle", "h_s": "m", "h_cg": "m",
  "m_s": "kg", "I_z": "kg m^2", "I_y_w": "kg m^2, of an axle", "R_w": "m", "T_sb": "-, brakes, front",
  "T_se": "-, engine, front", "p_ky1": "1/rad, stiffness over load", "p_dy1": "-, friction",
  "p_cy1": "-, shape", "p_kx1": "-, stiffness over load",
}  # fmt: skip


def _write(job: Job, path: Path) -> Sequence[str]:
  car = gym_numbers(job, TARGET, SWITCH_SPEED)
  mean = 0.5 * (car["C_Sf"] + car.pop("C_Sr"))
  car = matched_numbers(job, TARGET, car | {"C_Sf": mean}, MATCHED)
  q, v = quantities_of(job.twin, job.theta, job.kept(TARGET)), job.twin.vehicle
  axles, shape = v.driven_axles, float(np.mean(q["tyre_shape"]))
  along = float(np.sum(q["longitudinal_stiffness"])) / (car["m"] * GRAVITY)
  tyre = dict.fromkeys(_TYRE, 0.0) | {
    "p_cx1": shape, "p_dx1": car["mu"], "p_kx1": along, "p_cy1": shape, "p_dy1": car["mu"],
    "p_ky1": -car["mu"] * car["C_Sf"], "r_cx1": 1.0, "r_cy1": 1.0,
  }  # fmt: skip
  front = 0.5 if len(axles) == 2 else float("front" in axles)
  values = {
    "l": car["length"], "w": car["width"],
    "steering": {"min": car["s_min"], "max": car["s_max"], "v_min": car["sv_min"], "v_max": car["sv_max"]},
    "longitudinal": {name: car[name] for name in ("v_min", "v_max", "v_switch", "a_max") if name in car},
    "m": car["m"], "m_s": car["m"] - 4.0 * v.wheel_mass, "a": car["lf"], "b": car["lr"], "I_z": car["I"],
    "h_cg": car["h"], "h_s": car["h"], "R_w": v.wheel_radius, "I_y_w": 2.0 * v.wheel_inertia, "T_sb": front,
    "T_se": front, _TYRE_KEY: tyre,
  }  # fmt: skip
  drive = {name: car[name] for name in DRIVE} | {"switch_speed": SWITCH_SPEED}
  note = "# The drive line, for which CommonRoad has no keys: a = G R (P1 u - P2 w - P3 sgn w)."
  told = [f"# {said}." for said in unsaid(car)]
  about = _ABOUT | {"drive_gain": gain_unit(v)}
  text_lines(
    path, [*heading(job, job.lost(TARGET)), *told, *yaml_lines(values, about), note, *extra_lines(drive, about)]
  )
  return ["one tyre for both axles; the loss below is that of ST, STD is written and not driven", *unsaid(car)]


def _drives(path: Path, job: Job) -> tuple[CarModel, Mapping[str, object]]:
  p = read_numbers(path)
  names = {"m": "m", "a": "lf", "b": "lr", "I_z": "I", "h_s": "h", "steering.min": "s_min", "steering.max": "s_max"}
  names |= {"steering.v_min": "sv_min", "steering.v_max": "sv_max", "longitudinal.a_max": "a_max"}
  names |= {name: name for name in (*DRIVE, "switch_speed")} | {f"{_TYRE_KEY}.p_dy1": "mu"}
  car = {own: p[theirs] for theirs, own in names.items()}
  return gym_track, car | {"C_Sf": -p[f"{_TYRE_KEY}.p_ky1"] / p[f"{_TYRE_KEY}.p_dy1"]}  # type: ignore[return-value]


TARGET = Target(
  name="commonroad",
  file="parameters_vehicle.yaml",
  summary="CommonRoad's single-track and drift parameters",
  write=_write,
  expresses=expresses,
  drives=_drives,
  structure=STRUCTURE,
)
