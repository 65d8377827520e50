"""A lab session small enough for tests: a twin with known numbers drives it, sensor noise is added."""

import numpy as np

from qcar_twin.plant import SIGNALS, START, Segments
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR

PERIOD = 0.01
LENGTH = 300  # samples of a recording
NUMBERS = {
  name: getattr(QCAR, name)
  for name in ("name", "mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "track_width", "cg_height", "wheel_radius",
               "gear_ratio", "max_steering", "imu_x", "imu_y", "servo_time_constant")
}  # fmt: skip
NOISE = {"motor_speed": 0.5, "yaw_rate": 0.006, "accel_x": 0.05, "accel_y": 0.05}
TRUTH = {"torque_per_volt": 1.15, "cornering_stiffness_front": 0.85, "cornering_stiffness_rear": 0.9}  # of nominal
VOLTS = {"identify": (1.0, 2.0), "validate": (1.5,)}
ANGLES = {"identify": (0.1, 0.2), "validate": (0.15,)}
CRUISE, SPEED = 1.45, 1.5  # V and m/s of the step steers


def commands_of(manoeuvre: str, level: float) -> np.ndarray:
  """Voltage and steering, (LENGTH, 2)."""
  commands = np.zeros((LENGTH, 2))
  if manoeuvre == "voltage_step":
    commands[50:, 0] = level
  elif manoeuvre == "steering_step":
    commands[:, 0], commands[100:, 1] = CRUISE, level
  else:
    time = PERIOD * np.arange(LENGTH)
    commands[:, 0] = 1.6 + 0.5 * np.sin(2.0 * time)
    commands[:, 1] = level * np.sin(3.0 * time)
  return commands


def plan() -> list[tuple[str, str, str, float]]:
  """Name, role, manoeuvre, level of every recording."""
  runs = [(f"voltage_{v:g}", role, "voltage_step", v) for role, values in VOLTS.items() for v in values]
  runs += [(f"steering_{a:g}", role, "steering_step", a) for role, values in ANGLES.items() for a in values]
  roles = ("identify", "validate", "holdout")
  return runs + [(f"weave_{role}", role, "excitation", 0.12 + 0.04 * k) for k, role in enumerate(roles)]


def write(
  folder,
  concealed: dict[str, dict[str, float]] | None = None,
  seed: int = 0,
  run_in: int = 0,
  noise: dict[str, float] | None = None,
) -> DataSet:
  """Drive the session and write it; returns it as loaded.

  concealed: mechanism -> parameter -> value of physics the car has beyond the base.
  run_in: samples under the first command before the log begins. Without it cars begin in mid-drive as none can: their
    wheels roll without slip under a motor that pulls.
  """
  twin = Twin(QCAR, select(list(concealed or {})), substeps=2, threads=1)
  values = {name: share * twin.parameters[name].nominal for name, share in TRUTH.items()}
  for more in (concealed or {}).values():
    values |= more
  theta = twin.parameters.vector(twin.parameters.named(twin.parameters.nominal) | values)
  runs = plan()
  start = np.zeros((len(runs), len(START)))
  start[[r[2] != "voltage_step" for r in runs], START.index("velocity_x")] = SPEED
  commands = np.stack([commands_of(manoeuvre, level) for _, _, manoeuvre, level in runs])
  names = tuple(r[0] for r in runs)
  driven = np.concatenate([np.repeat(commands[:, :1], run_in, axis=1), commands], axis=1)
  segments = Segments(driven, start, np.full(len(runs), LENGTH + run_in), PERIOD, names, np.zeros(len(runs)))
  signals, rng, made = twin.rollout(theta, segments).signals[0, :, run_in:-1], np.random.default_rng(seed), []
  for (name, role, manoeuvre, _), u, rows in zip(runs, commands, signals, strict=True):
    columns = {"motor_voltage": u[:, 0], "steering_command": u[:, 1]}
    for channel, std in (noise or NOISE).items():
      columns[channel] = rows[:, SIGNALS.index(channel)] + std * rng.standard_normal(LENGTH)
    time = PERIOD * np.arange(LENGTH)
    made.append(Recording.from_columns(name, time, columns, role=role, manoeuvre=manoeuvre))
  write_dataset(folder, "tiny", NUMBERS, {"mass": 0.02, "yaw_inertia": 0.004}, made)
  return DataSet.load(folder)
