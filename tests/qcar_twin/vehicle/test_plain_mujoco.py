"""assets/qcar.xml in MuJoCo alone, without the tyre plugin: keyframes, controls, sensors and numbers."""

import functools
import math
import os
import shutil
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from qcar_twin.vehicle.mjcf import car_spec
from qcar_twin.vehicle.vehicle import ASSETS, Vehicle
from tests import ROOT

CAR = Vehicle.load()
FILE = str(ASSETS / "qcar.xml")
BEAMS = 36
FIELDS = (
  "body_mass", "body_pos", "body_ipos", "body_inertia", "dof_armature", "dof_damping", "dof_frictionloss",
  "jnt_stiffness", "qpos0", "qpos_spring", "geom_pos", "geom_size", "geom_friction", "actuator_gainprm",
  "actuator_biasprm", "actuator_dynprm", "actuator_ctrlrange", "actuator_forcerange",
)  # fmt: skip


@functools.cache
def plain() -> mujoco.MjModel:
  return mujoco.MjModel.from_xml_path(FILE)


def started(keyframe: str, *ctrl: float, seconds: float = 0.0) -> mujoco.MjData:
  """The car after some time from a keyframe, under its own controls where none are given."""
  data = mujoco.MjData(plain())
  mujoco.mj_resetDataKeyframe(plain(), data, plain().key(keyframe).id)
  if ctrl:
    data.ctrl[:] = ctrl
  mujoco.mj_step(plain(), data, round(seconds / plain().opt.timestep))
  mujoco.mj_forward(plain(), data)
  return data


def heading(data: mujoco.MjData) -> float:
  """Yaw angle, rad."""
  w, _, _, z = data.sensor("orientation").data
  return 2.0 * math.atan2(z, w)


@pytest.mark.parametrize("field", FIELDS)
def test_the_file_alone_has_the_qcars_numbers(field):
  twin = car_spec(CAR, tyre="native", looks=True).compile()
  np.testing.assert_allclose(getattr(plain(), field), getattr(twin, field), rtol=1e-5, atol=1e-7)


def test_the_file_alone_has_the_qcars_gears():
  twin = car_spec(CAR, tyre="native", looks=True).compile()
  for name in ("front_axle", "rear_axle", "axles"):
    ratios = [m.wrap_prm[m.tendon_adr[k := m.tendon(name).id] :][: m.tendon_num[k]] for m in (plain(), twin)]
    np.testing.assert_allclose(*ratios, rtol=1e-5)
  half = plain().eq_data[plain().equality("ackermann").id, 2]
  assert half == pytest.approx(CAR.ackermann_fraction * CAR.track_width / (2.0 * CAR.wheelbase), rel=1e-5)


def test_home_is_at_rest_and_stays_there():
  data = started("home")
  start, fastest = data.qpos.copy(), 0.0
  for _ in range(1000):
    mujoco.mj_step(plain(), data)
    fastest = max(fastest, np.abs(data.qvel).max())
  assert fastest < 1e-6 and np.abs(data.qpos - start).max() < 1e-7
  assert data.qpos[2] == pytest.approx(CAR.cg_height, abs=1e-4)


def test_driving_keeps_one_metre_per_second_straight_ahead():
  data = started("driving", seconds=2.0)
  assert data.qvel[0] == pytest.approx(1.0, rel=2e-3) and data.qpos[0] == pytest.approx(2.0, rel=2e-3)
  assert abs(data.qpos[1]) < 1e-9
  speed = data.sensor("encoder").data[0] * CAR.gear_ratio * CAR.wheel_radius
  assert speed == pytest.approx(1.0, rel=2e-3)


@pytest.mark.parametrize("volts, forwards", [(2.0, 1.0), (-2.0, -1.0)])
def test_positive_volts_drive_forwards(volts, forwards):
  data = started("home", volts, 0.0, seconds=1.0)
  assert forwards * data.qpos[0] > 0.3
  assert forwards * data.sensor("encoder").data[0] > 100.0 and forwards * data.sensor("encoder_angle").data[0] > 0.0


@pytest.mark.parametrize("angle", [0.2, -0.2])
def test_positive_steering_turns_left(angle):
  """At low lateral acceleration the yaw rate is v tan(delta) / L within the wheels' slip."""
  data = started("driving", 1.142, angle, seconds=2.0)
  assert data.sensor("steering_angle").data[0] == pytest.approx(angle, rel=0.02)
  speed = math.hypot(*data.qvel[:2])
  rate = data.sensor("gyro").data[2]
  assert rate == pytest.approx(speed * math.tan(angle) / CAR.wheelbase, rel=0.05)
  assert math.copysign(1.0, heading(data)) == math.copysign(1.0, angle)
  assert data.sensor("accelerometer").data[1] == pytest.approx(rate * speed, rel=0.1)


def test_every_sensor_is_named_and_finite():
  data, names = started("driving", 3.0, 0.3, seconds=1.0), []
  for index in range(plain().nsensor):
    names.append(plain().sensor(index).name)
    assert np.isfinite(data.sensor(index).data).all(), names[-1]
  beams = [f"lidar_{k:02d}" for k in range(BEAMS)]
  own = ["accelerometer", "gyro", "encoder", "orientation", "encoder_angle", "steering_angle"]
  assert names == own + beams


def test_the_lidar_sees_walls_where_they_are_and_not_the_car():
  """Walls 2 m ahead and 1 m to the left of the lidar: every beam meets the nearer or nothing."""
  spec, lidar = mujoco.MjSpec.from_file(FILE), np.array([-0.012, 0.0])
  box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "contype": 1}
  spec.worldbody.add_geom(name="ahead", size=[0.05, 30, 0.5], pos=[lidar[0] + 2.05, 0, 0.5], **box)
  spec.worldbody.add_geom(name="left", size=[30, 0.05, 0.5], pos=[0, 1.05, 0.5], **box)
  model = spec.compile()
  data = mujoco.MjData(model)
  mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
  mujoco.mj_forward(model, data)
  for k in range(BEAMS):
    cos, sin = math.cos(2.0 * math.pi * k / BEAMS), math.sin(2.0 * math.pi * k / BEAMS)
    ranges = [d / c for d, c in ((2.0, cos), (1.0, sin)) if c > 1e-6]
    assert data.sensor(f"lidar_{k:02d}").data[0] == pytest.approx(min(ranges, default=-1.0), rel=1e-4), k


def test_the_twin_reads_three_sensors_and_has_no_keyframes():
  twin = car_spec(CAR, looks=True).compile()
  assert [twin.sensor(k).name for k in range(twin.nsensor)] == ["accelerometer", "gyro", "encoder"]
  assert [twin.site(k).name for k in range(twin.nsite)] == ["imu", "lidar"] and twin.nkey == 0


def test_one_car_leaves_the_next_untouched():
  """The file is read once per process; what one car writes must not reach another."""
  sizes = []
  for car in (CAR, Vehicle(mass=5.0, yaw_inertia=0.08, layout="rear"), CAR):
    model = car_spec(car).compile()
    sizes.append((model.neq, model.body_mass.sum(), model.names))
  assert sizes[0] == sizes[2] != sizes[1]


@pytest.mark.parametrize("place", ["qcar_twin/assets", "assets"], ids=["wheel", "checkout"])
def test_the_file_is_there_in_a_wheel_and_in_a_bare_checkout(tmp_path, place):
  ignored = shutil.ignore_patterns("__pycache__", "_build")
  shutil.copytree(ROOT / "qcar_twin", tmp_path / "qcar_twin", ignore=ignored)
  shutil.copytree(ROOT / "assets", tmp_path / place, ignore=ignored)
  code = (
    "import mujoco; from qcar_twin.vehicle.vehicle import ASSETS, Vehicle; Vehicle.load();"
    "print(ASSETS, mujoco.MjModel.from_xml_path(str(ASSETS / 'qcar.xml')).nkey)"
  )
  env = os.environ | {"PYTHONPATH": str(tmp_path)}
  run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
  assert run.stdout.split() == [str(tmp_path.resolve() / place), "2"], run.stderr[-2000:]
