"""What a camera sees: the car with its looks, the reference path, lane borders, and a translucent second car.

Cars are posed, not simulated: any row of `plant.SIGNALS` will do, simulated or recorded.
"""

import math

import mujoco
import numpy as np
from matplotlib.colors import to_rgba
from numpy.typing import NDArray

from qcar_twin.paths import Path
from qcar_twin.plant import signal_index
from qcar_twin.plotting import BORDER, GHOST, PATH
from qcar_twin.vehicle.mjcf import car_spec
from qcar_twin.vehicle.vehicle import WHEELS, Vehicle

Array = NDArray[np.float64]
GHOST_PREFIX = "ghost_"
DASH = 0.06  # m, of the reference path
_PATH, _BORDER, _GHOST = to_rgba(PATH), to_rgba(BORDER), to_rgba(GHOST, alpha=0.35)
_X, _Y, _YAW, _SPEED, _STEERING = (
  signal_index(name) for name in ("pose_x", "pose_y", "pose_yaw", "velocity_x", "steering_angle")
)


def scene(vehicle: Vehicle, path: Path | None = None, ghost: bool = False) -> mujoco.MjSpec:
  """A spec to render: one car, or two, on the floor with a path drawn on it. Nothing in it is meant to be simulated."""
  spec = car_spec(vehicle, tyre="native", timestep=0.01, looks=True)
  if ghost:
    _attach_ghost(spec, vehicle)
  if path is not None:
    _draw_path(spec, path)
    _draw_lanes(spec, path)
  return spec


def _attach_ghost(spec: mujoco.MjSpec, vehicle: Vehicle) -> None:
  other = car_spec(vehicle, tyre="native", timestep=0.01, looks=True)
  for part in [other.geom("floor"), *other.cameras, *other.lights]:
    other.delete(part)
  for geom in other.geoms:
    geom.material = ""
    geom.rgba = _GHOST if geom.group == 2 else (0.0, 0.0, 0.0, 0.0)
  spec.attach(other, prefix=GHOST_PREFIX, frame=spec.worldbody.add_frame())


def _draw_path(spec: mujoco.MjSpec, path: Path) -> None:
  """Dashes along the reference."""
  ends = np.arange(0.0, path.length, 2.0 * DASH)
  for first in ends:
    a, b = path.at(first), path.at(min(first + DASH, path.length))
    spec.worldbody.add_geom(
      type=mujoco.mjtGeom.mjGEOM_CAPSULE,
      fromto=[float(a.x), float(a.y), 0.001, float(b.x), float(b.y), 0.001],
      size=[0.004, 0.0, 0.0],
      rgba=_PATH,
      contype=0,
      conaffinity=0,
      group=2,
    )


def _draw_lanes(spec: mujoco.MjSpec, path: Path) -> None:
  """Walls a hand high along the borders."""
  for lane in path.lanes:
    for side in (lane.left, lane.right):
      spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.5 * (lane.start + lane.end), side, 0.02],
        size=[0.5 * (lane.end - lane.start), 0.002, 0.02],
        rgba=_BORDER,
        contype=0,
        conaffinity=0,
        group=2,
      )


class Puppet:
  """One car of a scene, put where signals say it is.

  Args:
    model: compiled from `scene`.
    vehicle: the same car.
    prefix: "" for the car, GHOST_PREFIX for the second one.
  """

  def __init__(self, model: mujoco.MjModel, vehicle: Vehicle, prefix: str = ""):
    at = lambda name: int(model.joint(prefix + name).qposadr[0])
    self._vehicle, self._free = vehicle, at("chassis")
    self._knuckles = [at(f"{wheel}_steering") for wheel in WHEELS[:2]]
    self._spins = [at(f"{wheel}_spin") for wheel in WHEELS]
    self._roll = 0.0

  def pose(self, qpos: Array, signals: Array, elapsed: float = 0.0) -> None:
    """Write one row of signals, (10,), into generalised positions; the wheels roll on by `elapsed` s."""
    vehicle, yaw, steering = self._vehicle, signals[_YAW], signals[_STEERING]
    self._roll += elapsed * float(np.nan_to_num(signals[_SPEED])) / vehicle.wheel_radius
    place = [signals[_X], signals[_Y], vehicle.cg_height, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
    qpos[self._free : self._free + 7] = place
    curve = vehicle.ackermann_fraction * vehicle.track_width / (2.0 * vehicle.wheelbase) * steering**2
    qpos[self._knuckles] = [steering + curve, steering - curve]
    qpos[self._spins] = self._roll


def settle_view(model: mujoco.MjModel, data: mujoco.MjData) -> None:
  """Bring what a camera needs in line with the positions; no dynamics."""
  mujoco.mj_kinematics(model, data)
  mujoco.mj_comPos(model, data)
  mujoco.mj_camlight(model, data)
