"""A tyre test rig: one wheel under a carriage so heavy that its motion is prescribed. Used by the tyre tests."""

import dataclasses

import mujoco
import numpy as np

from qcar_twin.vehicle.tyre import add_tyres, law_parameters, tyre_user_data

SHARED = {
  "cornering_stiffness": 90.0,
  "longitudinal_stiffness": 135.0,
  "friction_coefficient": 0.8,
  "load_exponent": 0.0,
  "nominal_load": 6.6,
  "relaxation_length": 0.0,
  "longitudinal_relaxation": 0.0,
  "carcass_damping": 0.0,
  "rim_mass": 0.0,
}
TYRE = SHARED | {"tyre_shape": 1.4}
_MODEL = """
<mujoco>
  <option timestep="{h}" integrator="Euler" cone="elliptic" jacobian="{jacobian}" tolerance="1e-12">
    <flag eulerdamp="disable"/>
  </option>
  <worldbody>
    <geom name="floor" type="{floor}" size="50 50 0.05" pos="0 0 {floor_z}" contype="1" conaffinity="0"/>
    {wall}
    <body name="carriage" pos="0 0 0.033">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="1e7" diaginertia="1 1 1"/>
      <body name="hub">
        <joint name="z" type="slide" axis="0 0 1" damping="20"/>
        <joint name="spin" type="hinge" axis="0 1 0" armature="1e7"/>
        <inertial pos="0 0 0" mass="{mass}" diaginertia="1e-4 1e-4 1e-4"/>
        <geom name="wheel" type="ellipsoid" size="0.033 0.015 0.033" contype="0" conaffinity="1" condim="3" priority="1"
              solref="0.01 1" solimp="0.99 0.99 0.001"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@dataclasses.dataclass
class Rig:
  """One wheel on a prescribed path; forces are those of the ground on the wheel, N."""

  model: mujoco.MjModel
  data: mujoco.MjData

  @classmethod
  def of(
    cls,
    h: float = 0.002,
    load: float = 6.6,
    jacobian: str = "dense",
    floor: str = "plane",
    wall: bool = False,
    law: str = "sine",
    **tyre: float,
  ) -> "Rig":
    floor_z = 0.0 if floor == "plane" else -0.05
    ahead = '<geom name="wall" type="box" size="0.1 1 1" pos="0.1445 0 0" contype="1" conaffinity="0"/>' if wall else ""
    text = _MODEL.format(h=h, mass=load / 9.81, jacobian=jacobian, floor=floor, floor_z=floor_z, wall=ahead)
    spec = mujoco.MjSpec.from_string(text)
    own = {p.name: p.nominal for p in law_parameters(law)}
    add_tyres(spec, "carriage", {"wheel": tyre_user_data(law, **(SHARED | own | tyre))})
    model = spec.compile()
    rig = cls(model, mujoco.MjData(model))
    rig.settle()
    return rig

  def settle(self) -> None:
    """Stand until the load is carried."""
    self.run(0.0, 0.0, 0.0, 0.4)

  def run(self, forward: float, left: float, rolling: float, seconds: float) -> np.ndarray:
    """Drive at constant velocities, m/s, `rolling` being spin times radius; F_x, F_y, F_z after each step, (n, 3)."""
    self.data.qvel[[0, 1, 3]] = forward, left, rolling / self.radius
    steps = max(1, round(seconds / self.model.opt.timestep))
    forces = np.empty((steps, 3))
    for k in range(steps):
      mujoco.mj_step(self.model, self.data)
      forces[k] = self.data.qfrc_constraint[[0, 1, 2]]
    return forces

  @property
  def radius(self) -> float:
    """Distance from the axle to the point of contact, m."""
    hub = self.data.body("hub").xpos[2]
    return float(hub - self.data.contact[0].pos[2]) if self.data.ncon else 0.033

  @property
  def state(self) -> np.ndarray:
    """Load, slip along, slip across."""
    return self.data.plugin_state.copy()


def steady_force(forward: float, left: float, rolling: float, load: float = 6.6, **tyre: float) -> np.ndarray:
  """The steady combined-slip law in closed form: F_x, F_y, N."""
  t = TYRE | tyre
  slip = np.array([forward - rolling, left])
  speed = np.sqrt(rolling**2 + slip @ slip + 0.005**2)
  fall = (load / t["nominal_load"]) ** -t["load_exponent"]
  stiffness = np.array([t["longitudinal_stiffness"], t["cornering_stiffness"]]) * fall * load / t["nominal_load"]
  linear = stiffness * slip / speed
  peak = t["friction_coefficient"] * fall * load
  rho, shape = np.linalg.norm(linear) / peak, t["tyre_shape"]
  return -linear * (np.sin(shape * np.arctan(rho / shape)) / rho if rho > 0 else 1.0)


def peak_friction(direction: float, law: str = "sine") -> float:
  """Highest force / load met while the slip grows along one direction, rad from the rolling direction."""
  rig, best = Rig.of(h=0.001, law=law), 0.0
  for slip in np.linspace(0.02, 0.9, 60):
    force = rig.run(1.0, slip * np.sin(direction), 1.0 - slip * np.cos(direction), 0.02)[-1]
    best = max(best, np.hypot(*force[:2]) / force[2])
  return best


def recovered_relaxation(length: float, speed: float, damping: float, axis: int = 1) -> tuple[float, float]:
  """Relaxation length found in the answer to a step of slip, m, and the log of 1 - force at its start.

  Along (axis 0) or across (1); in the other direction there is none.
  """
  name = ("longitudinal_relaxation", "relaxation_length")[axis]
  rig = Rig.of(h=0.001, carcass_damping=damping, **{name: length})
  rig.run(speed, 0.0, speed, 0.3)
  moved = (1.01 * speed, 0.0) if axis == 0 else (speed, 0.01 * speed)
  steady = steady_force(*moved, speed)[axis]
  share = rig.run(*moved, speed, 5.0 * length / speed)[:, axis] / steady
  distance, rising = speed * 0.001 * np.arange(1, len(share) + 1), share < 0.95
  slope, start = np.polyfit(distance[rising], np.log(1.0 - share[rising]), 1)
  return -1.0 / slope, start


if __name__ == "__main__":
  for h in (0.0005, 0.002, 0.005):
    for speed in (0.3, 0.5, 1.0, 2.0):
      force = Rig.of(h=h).run(speed, 0.001 * speed, speed, 0.05)[-1]
      print(f"{1e3 * h:g} ms, {speed:g} m/s: cornering stiffness {-1e3 * force[1]:.2f} N/rad, asked for 90")
  for angle in (0.0, 0.6, np.pi / 2):
    print(f"peak friction at {angle:.2f} rad: {peak_friction(angle):.4f}, asked for 0.8")
  for length in (0.03, 0.1):
    for speed in (0.5, 1.5):
      along, across = (1e3 * recovered_relaxation(length, speed, 40.0, axis)[0] for axis in (0, 1))
      print(f"relaxation at {speed:g} m/s: {along:.2f} mm along, {across:.2f} across, asked for {1e3 * length:g}")
