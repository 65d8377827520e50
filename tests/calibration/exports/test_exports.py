"""Exports: the written files are run, in plain MuJoCo, by import and by their own equations, beside the twin."""

import dataclasses
import importlib.util
import re
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from calibration.exports import single_track
from calibration.exports.cars import ModelCars
from calibration.exports.export import export_twin
from calibration.exports.loss import EffectLoss, Loss, measure_loss
from calibration.exports.numbers import EXPRESSED, driven, single_track_numbers, without
from calibration.exports.target import Job, target_named, targets
from calibration.exports.yaml_numbers import read_numbers
from calibration.fitting.windows import Cut, cut_recordings
from qcar_twin.plant import signal_index
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import WHEELS, Vehicle
from tests import ROOT

EFFECTS = {
  "steering_offset": 0.02, "steering_gain_error": 0.05, "steering_asymmetry": 0.05, "steering_delay": 0.034,
  "steering_lag": 0.03, "drive_delay": 0.025, "drive_lag": 0.04, "battery_sag": 0.2, "quadratic_drag": 0.3,
  "side_force": 0.5, "gyro_bias": 0.01, "payload_mass": 0.3, "command_delay": 0.01,
}  # fmt: skip
NAMES = (*EXPRESSED, "gyro_bias", "payload")


def job_with(effects, dataset=None, **options):
  data = DataSet.load(ROOT / "data" / "sample")
  names = [n for n in NAMES if n in effects or f"{n}_mass" in effects]
  twin = Twin(Vehicle.from_dataset(data.vehicle, data.vehicle_std), select(names), threads=1)
  theta = twin.parameters.nominal.copy()
  for name, value in effects.items():
    theta[twin.parameters.index(name)] = value
  return Job(twin, theta, dataset, options=options)


@pytest.fixture(scope="module")
def sample():
  """Two short recordings for each of three roles."""
  data = DataSet.load(ROOT / "data" / "sample")
  wanted = ("circles_fast", "voltage_step_2V", "excitation_a", "excitation_b", "free_drive_a", "free_drive_b")
  roles = dict(zip(wanted, ("identify",) * 4 + ("holdout",) * 2, strict=True))
  chosen = [dataclasses.replace(data[name], role=role) for name, role in roles.items()]
  return dataclasses.replace(data, recordings=tuple(chosen))


@pytest.fixture(scope="module")
def exported(sample, tmp_path_factory):
  job = job_with(EFFECTS, sample)
  path, loss = export_twin("single-track", job, tmp_path_factory.mktemp("export"))
  return job, path, loss


def apart(job, target, path, recordings):
  """Difference of the written file from the twin by channel, over the twin's own standard deviation."""
  segments = cut_recordings(recordings, job.twin.vehicle, Cut(length=2.0, warm_up=0.0)).segments
  twin, theta = without(job.twin, job.theta, job.kept(target))
  model, car = target.drives(path, job)
  other, bare = without(job.twin, job.theta, [])
  shown = other.with_engine(lambda size: ModelCars(model, car, size)).rollout(bare, segments).signals[0]
  wanted = twin.rollout(theta, segments).signals[0]
  inside = np.arange(wanted.shape[1]) <= segments.steps[:, None]
  return {
    name: float(np.sqrt(np.mean((a - b) ** 2)) / np.std(b))
    for name in ("yaw_rate", "accel_y", "motor_speed", "velocity_x")
    for a, b in [(s[..., signal_index(name)][inside] for s in (shown, wanted))]
  }


def test_the_single_track_does_what_the_twin_does_with_every_effect_it_names(exported, sample):
  job, path, _ = exported
  assert {m.name for m in job.kept(target_named("single-track"))} == {*EXPRESSED, "payload"}
  holdout = [r for r in sample.recordings if r.role == "holdout"]
  assert max(apart(job, target_named("single-track"), path, holdout).values()) < 0.08


@pytest.mark.parametrize("name", [n for n in EXPRESSED if n in EFFECTS])
def test_an_effect_is_the_twins_own(name, sample, tmp_path):
  """Taking an effect out of the twin moves it by more than the file with the effect differs from it."""
  target, data = target_named("single-track"), [r for r in sample.recordings if r.role == "holdout"]
  job = job_with({name: 3.0 * EFFECTS[name]})
  target.write(job, tmp_path / "with.py")
  target.write(job_with({}), tmp_path / "without.py")
  held, gone = (apart(job, target, tmp_path / f, data) for f in ("with.py", "without.py"))
  channel = max(gone, key=lambda c: gone[c] - held[c])
  assert held[channel] < 0.8 * gone[channel]


def test_the_module_stands_alone(exported, tmp_path):
  _, path, _ = exported
  code = (
    "import sys, numpy, single_track as s; x = s.at_start(s.CAR, numpy.zeros(7), numpy.zeros(2));"
    "y = [x := s.step(x, numpy.array([2.0, 0.2]), s.CAR)[0] for _ in range(200)][-1];"
    "assert not [m for m in sys.modules if m.split('.')[0] in ('qcar_twin', 'calibration', 'mujoco', 'casadi')];"
    "assert y[3] > 0.3 and y[2] > 0.2, y"
  )
  subprocess.run([sys.executable, "-c", code], cwd=path.parent, check=True)


def test_the_casadi_function_is_the_numpy_module(exported):
  pytest.importorskip("casadi")
  job, path, _ = exported
  module, car = target_named("single-track").drives(path, job)
  function, x = module.casadi_step(car), module.at_start(car, np.array([0, 0, 0, 1.0, 0, 0, 0]), np.array([1.0, 0.0]))
  for k in range(50):
    u = np.array([1.0 + np.sin(0.1 * k), 0.3 * np.sin(0.05 * k)])
    after, sensed = module.step(x, u, car)
    theirs = function(x, u)
    np.testing.assert_allclose(theirs[0].full().ravel(), after, atol=1e-12)
    np.testing.assert_allclose(theirs[1].full().ravel(), sensed, atol=1e-9)
    x = after


def test_cars_side_by_side_are_cars_alone(exported):
  job, path, _ = exported
  module, car = target_named("single-track").drives(path, job)
  start = np.array([[0, 0, 0, 1.0, 0, 0, 0], [0, 0, 1.0, 0.3, 0, 0.1, 0.1]])
  commands = np.tile(np.array([[2.0, 0.1], [1.0, -0.2]])[:, None], (1, 30, 1))
  both = driven(module, car, start, commands)
  alone = driven(module, car, start[1:], commands[1:])
  np.testing.assert_allclose(both[:, :, 1:], alone, atol=1e-12)


def test_what_the_voltage_moves_has_the_fitted_inertia_of_the_wheels():
  light, heavy = (job_with({"wheel_inertia": inertia}) for inertia in (5e-5, 9e-5))
  moved = [single_track_numbers(job.twin, job.theta, [])["moved_mass"] for job in (light, heavy)]
  assert moved[1] - moved[0] == pytest.approx(4.0 * 4e-5 / light.twin.vehicle.wheel_radius**2)


def test_a_standing_car_stands_and_a_weak_push_moves_nothing(exported):
  job, _, _ = exported
  car = single_track_numbers(job.twin, job.theta, [])
  module = target_named("single-track").drives(exported[1], job)[0]
  x = module.at_start(car, np.zeros(7), np.zeros(2))
  hold = 0.9 * car["drive_friction"] / car["drive_gain"]
  for _ in range(100):
    x, _ = module.step(x, np.array([hold, 0.2]), car)
  assert np.abs(x[:3]).max() < 1e-6


def test_plain_mujoco_opens_the_mjcf_and_drives_to_the_left(tmp_path):
  job = job_with({"steering_delay": 0.04, "steering_offset": 0.02, "payload_mass": 0.4})
  path, _ = export_twin("mjcf", job, tmp_path / "car.xml")
  model = mujoco.MjModel.from_xml_string(path.read_text(encoding="utf-8"))
  assert model.nplugin == 0 and not any(job.lost(target_named("mjcf")))
  assert float(model.body_mass.sum()) == pytest.approx(job.twin.vehicle.mass + 0.4, abs=1e-3)
  data = mujoco.MjData(model)
  data.ctrl[:] = 2.0, 0.2
  second = round(1.0 / model.opt.timestep)
  mujoco.mj_step(model, data, 2 * second)
  assert data.qpos[0] > 0.3 and data.qpos[1] > 0.05
  data = mujoco.MjData(model)
  data.ctrl[:] = 0.0, 0.2
  mujoco.mj_step(model, data, round(0.03 * second))
  early = float(data.ten("steering").length[0])
  assert abs(early) < 0.03  # 30 ms after a command that comes 40 ms late: the trim alone
  mujoco.mj_step(model, data, round(0.12 * second))
  assert float(data.ten("steering").length[0]) == pytest.approx(0.22, abs=0.005)


def test_the_mjcfs_tyre_has_the_twins_stiffness_at_its_speed(tmp_path):
  from calibration.exports.targets.mjcf import REFERENCE_SPEED

  job = job_with({})
  path, _ = export_twin("mjcf", job, tmp_path / "car.xml")
  model = mujoco.MjModel.from_xml_path(str(path))
  data = mujoco.MjData(model)
  second = round(1.0 / model.opt.timestep)
  mujoco.mj_step(model, data, second)
  data.xfrc_applied[model.body("chassis").id, 1] = 2.0
  mujoco.mj_step(model, data, second)
  v = job.twin.vehicle
  stiffness = v.cornering_stiffness_front + v.cornering_stiffness_rear
  assert 2.0 / data.qvel[1] * REFERENCE_SPEED == pytest.approx(stiffness, rel=0.03)


def test_a_centre_of_gravity_that_was_fitted_low_leaves_the_hull_where_it_is(tmp_path):
  """The hull was placed by the CG, so such a car lay on its belly."""
  job = job_with({"cg_height_offset": -0.036})
  path, _ = export_twin("mjcf", job, tmp_path / "car.xml")
  model = mujoco.MjModel.from_xml_path(str(path))
  data = mujoco.MjData(model)
  mujoco.mj_step(model, data, round(1.0 / model.opt.timestep))
  assert {model.geom(one).name for contact in data.contact for one in contact.geom} == {"floor", *WHEELS}
  height = float(data.subtree_com[model.body("chassis").id, 2])
  assert height == pytest.approx(job.twin.vehicle.cg_height - 0.036, abs=1e-3)
  data.ctrl[:] = 2.0, 0.0
  mujoco.mj_step(model, data, round(1.0 / model.opt.timestep))
  assert data.qpos[0] > 0.3


@pytest.mark.parametrize("name", ["single-track", "mjcf"])
def test_a_servo_that_overshoots_does_so_in_the_file(name, tmp_path):
  job, target = job_with({"servo_time_constant": 0.03, "servo_inertia": 1.0}), target_named(name)
  model, car = target.drives(export_twin(name, job, tmp_path)[0], job)
  start, command = np.array([[0, 0, 0, 1.0, 0, 0, 0]]), np.array([[1.2, 0.2]])
  twin, x = job.twin.begin(job.theta[None], start), model.at_start(car, start, command)
  steered = []
  for _ in range(25):
    x, sensed = model.step(x, command, car)
    steered.append((float(twin.step(command)[0, signal_index("steering_angle")]), float(sensed[0, 4])))
  wanted, shown = np.transpose(steered)
  assert 0.225 < wanted.max() < 0.24  # exp(-pi zeta / sqrt(1 - zeta^2)) of 0.2 rad beyond, zeta 0.5
  np.testing.assert_allclose(shown, wanted, atol=0.01)


@pytest.mark.slow
def test_what_plain_friction_costs_is_predicted_with_the_twins_tyre_made_to_creep(sample, tmp_path):
  _, loss = export_twin("mjcf", job_with({"servo_time_constant": 0.005}, sample), tmp_path)  # as quick as that car's
  assert loss is not None and loss.predicted == pytest.approx(loss.ratio, rel=0.1)
  (creeping,) = (e for e in loss.effects if e.name.startswith("tyres"))
  costs = creeping.document()["costs"]
  assert 1.05 < costs == pytest.approx(loss.ratio, rel=0.03)  # all that is measured: what else is lost costs nothing
  assert costs == pytest.approx(loss.predicted, rel=0.02)  # nothing else is lost


@pytest.mark.parametrize("name", ["f1tenth", "commonroad"])
def test_the_gyms_numbers_turn_as_the_twin_does(name, tmp_path):
  job, target = job_with({"payload_mass": 0.3}), target_named(name)
  path, _ = export_twin(name, job, tmp_path)
  model, car = target.drives(path, job)
  x, u = model.at_start(car, np.array([0, 0, 0, 1.0, 0, 0, 0.0]), np.zeros(2)), np.array([1.2, 0.1])
  for _ in range(150):
    x, sensed = model.step(x, u, car)
  v = job.twin.vehicle
  rolls = x[3] * np.tan(0.1) / v.wheelbase
  assert sensed[0] == pytest.approx(rolls, rel=0.15)
  assert car["m"] == pytest.approx(v.mass + 0.3)


def test_two_axles_on_a_shaft_hold_each_other_back_at_full_lock_as_the_twins_do():
  job = job_with({"longitudinal_stiffness": 300.0})
  car = single_track_numbers(job.twin, job.theta, job.kept(target_named("single-track")))
  start, command = np.array([[0, 0, 0, 0.8, 0, 0, 0.5]]), np.array([[1.2, 0.5]])
  twin = job.twin.begin(job.theta[None], start)
  wanted = np.array([twin.step(command)[0] for _ in range(200)])[-1]
  shown = driven(single_track, car, start, np.tile(command, (1, 200, 1)))[-1, 0, 0]
  np.testing.assert_allclose(shown[[0, 3]], wanted[[signal_index("yaw_rate"), signal_index("motor_speed")]], rtol=0.02)


def test_commonroads_own_package_reads_and_drives_the_file(tmp_path):
  pytest.importorskip("vehiclemodels")
  from omegaconf import OmegaConf
  from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st
  from vehiclemodels.vehicle_parameters import VehicleParameters

  job = job_with({})
  path, _ = export_twin("commonroad", job, tmp_path)
  merged = OmegaConf.merge(OmegaConf.structured(VehicleParameters), OmegaConf.load(path))
  theirs = vehicle_dynamics_st([0, 0, 0.1, 1.0, 0.2, 0.3, 0.02], [0.0, 0.5], OmegaConf.to_object(merged))
  model, car = target_named("commonroad").drives(path, job)
  held = car | {"drive_gain": 0.5 / car["travel_per_radian"], "drive_damping": 0.0, "drive_friction": 0.0}
  ours = model.derivative(np.array([0, 0, 0.1, 1.0, 0.2, 0.3, 0.02]), 0.0, 1.0, held)
  np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_what_is_lost_is_predicted_by_taking_it_out_of_the_twin(exported, sample, tmp_path):
  job, _, loss = exported
  assert loss.predicted == pytest.approx(1.0) and not loss.effects
  path, other = export_twin("f1tenth", job, tmp_path)
  named = {e.name: e for e in other.effects}
  assert {"steering_delay", "battery_sag"} <= named.keys() and "payload" not in named
  assert named["side_force"].measured is None and named["side_force"].predicted is None
  for name in ("steering_delay", "battery_sag"):  # beside all else that is lost
    assert named[name].measured == pytest.approx(named[name].predicted, rel=0.2)
  assert other.ratio == pytest.approx(other.predicted, rel=0.2)
  assert path.with_name("f1tenth.yaml.loss.json").is_file()


def test_a_reader_is_told_which_channel_loses_most_and_where_the_prediction_is_off():
  told = {"motor_speed": 1.0, "yaw_rate": 0.01}
  alone, beside = {"motor_speed": 2.0, "yaw_rate": 2.0}, {"motor_speed": 2.0, "yaw_rate": 0.5}
  effect = EffectLoss("battery_sag", alone, beside, {"motor_speed": 1.44, "yaw_rate": 1.0})
  loss = Loss(
    ("holdout",), told, {"motor_speed": 1.1, "yaw_rate": 0.071}, {"motor_speed": 1.2, "yaw_rate": 0.0555}, (effect,)
  )
  text = "\n".join(loss.lines())
  assert "without battery_sag: the twin 2.00 (motor_speed 2.00); all else lost, predicted 1.00 (motor_speed" in text
  assert "measured 1.20 (motor_speed 1.44)" in text
  assert EffectLoss("tyres", alone).line() == "without tyres: the twin 2.00 (motor_speed 2.00)"
  assert "yaw_rate loses most: 7.1 times the twin's error" in text
  assert "prediction off by more than 20 %: yaw_rate 5.55, measured 7.10" in text
  assert loss.document()["effects"][0]["measurements"] == {"motor_speed": 1.44, "yaw_rate": 1.0}
  same = Loss(("holdout",), told, told, told, ())
  assert same.sentences() == [] and same.ratio == 1.0


def test_a_file_that_was_changed_loses_more(exported, sample):
  job, path, loss = exported
  text = path.read_text(encoding="utf-8")
  worse = path.with_name("worse.py")
  worse.write_text(text.replace('"battery_sag": 0.2,', '"battery_sag": 0.6,'), encoding="utf-8")
  changed = measure_loss(job, target_named("single-track"), worse)
  assert changed.export["motor_speed"] > 1.2 * loss.export["motor_speed"]


def test_vesc_takes_a_trim_and_a_gain_out(tmp_path):
  present = tmp_path / "now.yaml"
  present.write_text("vesc:\n  steering_angle_to_servo_gain: -1.2\n  steering_angle_to_servo_offset: 0.5\n")
  job = job_with({"steering_offset": 0.03, "steering_gain_error": 0.1}, pole_pairs="2", vesc=str(present))
  made = read_numbers(export_twin("vesc", job, tmp_path)[0])
  wanted = 0.2
  servo = made["steering_angle_to_servo_gain"] * wanted + made["steering_angle_to_servo_offset"]
  command = (servo - 0.5) / -1.2  # what the present file calls this servo value
  assert 1.1 * command + 0.03 == pytest.approx(wanted)
  travel = job.twin.vehicle.gear_ratio * job.twin.vehicle.wheel_radius
  assert made["speed_to_erpm_gain"] == pytest.approx(2 * 60 / (2 * np.pi * travel))
  with pytest.raises(ValueError, match="--pole-pairs"):
    export_twin("vesc", job_with({}), tmp_path)


def test_the_ekf_gets_noise_and_latency_from_where_they_are(sample, tmp_path):
  job = job_with({"gyro_bias": 0.01}, sample)
  made = read_numbers(export_twin("robot-localization", job, tmp_path)[0])
  assert made["ekf_filter_node.ros__parameters.frequency"] == pytest.approx(100.0)
  assert made["gyro_bias"] == 0.01 and 1e-6 < made["variance_yaw_rate"] < 1e-3
  with pytest.raises(ValueError, match="--dataset"):
    export_twin("robot-localization", job_with({}), tmp_path)


def test_an_unknown_target_is_answered_with_the_nearest():
  with pytest.raises(KeyError, match="did you mean f1tenth"):
    target_named("f1tnth")
  with pytest.raises(KeyError, match="single-track"):
    target_named("zzz")
  assert all(t.summary and t.file for t in targets().values())


def test_the_block_of_the_guide_runs_beside_the_written_file(exported, monkeypatch):
  """docs/guide/exports.md, up to the line that needs the package casadi where that is not installed."""
  page = (ROOT / "docs" / "guide" / "exports.md").read_text(encoding="utf-8")
  (block,) = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
  if importlib.util.find_spec("casadi") is None:
    block = "".join(line for line in block.splitlines(keepends=True) if "casadi" not in line)
  monkeypatch.syspath_prepend(str(exported[1].parent))
  monkeypatch.delitem(sys.modules, "single_track", raising=False)
  names: dict[str, object] = {}
  exec(compile(block, "exports.md", "exec"), names)
  sensed = names["sensed"]
  assert isinstance(sensed, np.ndarray) and np.isfinite(sensed).all()
