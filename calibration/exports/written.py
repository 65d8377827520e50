"""Lines of files that people read: numbers with their units and where they are from."""

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path

from calibration.exports.target import Job
from qcar_twin.twin.mechanisms.base import Mechanism
from qcar_twin.vehicle.vehicle import Vehicle

UNITS = {
  "mass": "kg", "moved_mass": "kg, with motor and wheels that turn", "shaft_mass": "kg, what the motor turns of it",
  "yaw_inertia": "kg m^2", "cg_to_front": "m",
  "cg_to_rear": "m", "cg_height": "m",
  "travel_per_radian": "m/rad, of the motor", "drive_damping": "1/s, P2",
  "drive_friction": "rad/s^2, P3", "drive_front": "-, share of the drive that front tyres give",
  "centre_compliance": "m/(N s), one axle's lead over the other per force",
  "longitudinal_stiffness_front": "N, both wheels; 0 where they are not driven",
  "longitudinal_stiffness_rear": "N, both wheels; 0 where they are not driven",
  "cornering_stiffness_front": "N/rad, both wheels", "cornering_stiffness_rear": "N/rad, both wheels",
  "friction_coefficient": "-", "tyre_shape": "-", "load_exponent": "-", "relaxation_length": "m",
  "servo_time_constant": "s, lag", "servo_rate": "rad/s, highest of the road wheels",
  "servo_inertia": "-, 1 / (2 damping ratio)^2",
  "max_steering": "rad", "imu_x": "m", "imu_y": "m",
  "roll_gain": "-, what the accelerometer adds by rolling", "pitch_gain": "-, and by pitching",
}  # fmt: skip


def heading(job: Job, lost: Sequence[Mechanism], mark: str = "#") -> list[str]:
  """What a file is, as lines of comment."""
  names = ", ".join(m.name for m in job.present if m.stage != "sensor") or "none"
  missing = [m.name for m in lost]
  if job.twin.vehicle.differential == "locked":  # no target has one: a differential_lock is lost, too
    missing.append("the locked axle")
  lines = [
    f"{job.twin.vehicle.name}, exported by qcar-twin on {datetime.date.today().isoformat()}. SI units.",
    f"Effects of the car in the twin: {names}.",
    f"Not in this file: {', '.join(missing) or 'none of them'}.",
    f"The drive's command is in {_commanded_in(job.twin.vehicle)}.",
  ]
  return [f"{mark} {line}" for line in lines]


def gain_unit(vehicle: Vehicle) -> str:
  """What a drive line's gain P1 is in, by the command that a model of the drive takes; see `_commanded_in`."""
  return f"rad/s^2 per {vehicle.motor.unit if vehicle.motor.unit != '-' else 'V'}, P1"


def _commanded_in(vehicle: Vehicle) -> str:
  """What a model of the drive takes as its command, with its unit."""
  if vehicle.drive == "duty":
    return f"V on the motor: a duty times the battery's voltage, {vehicle.supply_voltage:g} V where nobody logged one"
  said = {"voltage": "V on the motor", "current": "A of the motor", "speed": "m/s of commanded speed"}
  return (said | {"acceleration": "m/s^2 of commanded acceleration"})[vehicle.drive]


def origin(name: str, factors: Mapping[str, float]) -> str:
  """Where a number of the single track is from."""
  if name in factors:
    return f"the twin's, times {factors[name]:.4g} to answer as the twin does"
  return "the twin's"


def text_lines(path: Path, lines: Sequence[str]) -> None:
  """Write lines as a file."""
  from qcar_twin.atomic_io import write_text

  write_text(path, "\n".join(lines) + "\n")
