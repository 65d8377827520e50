"""Windows, noise and refits on driving of the reduced car itself, whose truth is known to the last digit."""

import numpy as np
import pytest

from calibration.fitting.windows import Cut
from calibration.likelihood.body_force import BodyForce
from calibration.likelihood.hypotheses import options
from calibration.likelihood.linear import Place
from calibration.likelihood.noise import first_noise
from calibration.likelihood.readings import EVERY, read
from calibration.likelihood.refit import moved, refit
from calibration.likelihood.stray import stray_poses
from qcar_twin.parameters import ParameterSet
from qcar_twin.plant import START, Segments, signal_index
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

CAR = Vehicle.load()
PERIODS = 300
STD = {"motor_speed": 0.5, "accel_x": 0.05, "accel_y": 0.05, "yaw_rate": 0.006}
POSE_STD = 0.003
SHIFTED = 1.06  # times the nominal


def recordings(seed: int = 0) -> list[Recording]:
  """Two runs of a car whose front tyres are stiffer than stated."""
  rng, time = np.random.default_rng(seed), 0.01 * np.arange(PERIODS)
  driven = [
    (1.0 + 0.3 * np.sin(2.0 * time), 0.15 * np.sin(4.0 * time)),
    (0.8 + 0.5 * (time > 1.5), 0.1 * np.sign(np.sin(3.0 * time))),
  ]
  commands = np.stack([np.stack(pair, axis=-1) for pair in driven])
  twin = Twin(CAR, engine="reduced", threads=1)
  theta = twin.parameters.nominal
  theta[twin.parameters.index("cornering_stiffness_front")] *= SHIFTED
  segments = Segments(commands, np.zeros((2, len(START))), np.full(2, PERIODS), 0.01, ("a", "b"), np.zeros(2))
  signals = twin.simulate(theta[None], segments)[0]
  made = []
  for k, name in enumerate(("a", "b")):
    table = {"motor_voltage": commands[k, :, 0], "steering_command": commands[k, :, 1]}
    for channel, std in STD.items():
      table[channel] = signals[k, :PERIODS, signal_index(channel)] + std * rng.normal(size=PERIODS)
    for channel in ("pose_x", "pose_y", "pose_yaw"):
      value = signals[k, :PERIODS, signal_index(channel)] + POSE_STD * rng.normal(size=PERIODS)
      table[channel] = np.where(np.arange(PERIODS) % 10 == 0, value, np.nan)
    made.append(Recording.from_columns(name, time, table, file=f"{name}.csv"))
  return made


@pytest.fixture(scope="module")
def prepared():
  runs = recordings()
  twin = Twin(CAR, [*select(["steering_offset", "imu_latency"]), BodyForce()], engine="reduced", threads=1)
  readings = read(runs, CAR, Cut())
  return twin, readings, first_noise(runs, readings)


def test_every_reading_lies_in_its_own_window(prepared):
  _, readings, _ = prepared
  assert len(readings) == 2 * PERIODS // EVERY
  offset = readings.point + readings.fraction - readings.first_period[:, None]
  assert np.all((offset[readings.used] > 0.0) & (offset[readings.used] <= EVERY))
  encoder = readings.channel == readings.channels.index("motor_speed")
  assert readings.used[:, encoder].sum() == 2 * (PERIODS - 1)  # the first row is the start


def test_white_noise_is_read_off_the_recordings(prepared):
  _, readings, noise = prepared
  for name, std in STD.items():
    white = noise.white(readings, np.full(len(readings), 0.8))[:, readings.channel == readings.channels.index(name)]
    assert np.isclose(np.median(white), std, rtol=0.25), name


def test_a_column_is_what_a_change_of_its_parameter_does(prepared):
  twin, readings, noise = prepared
  place = Place(twin, readings, noise, twin.parameters.nominal, readings.starts)
  column, ends = place.columns(*moved(place, [twin.parameters["mass"]]))
  theta = place.theta.copy()
  change = 0.02
  theta[twin.parameters.index("mass")] += change
  predicted, ended = place.simulate(theta[None], readings.starts)
  there = place.compress(((predicted[0] - place.predicted) * place.weight)[..., None])[..., 0]
  assert np.allclose(there, change * column[..., 0], atol=0.05 * np.abs(there).max() + 1e-6)
  inner = ~np.append(readings.begins[1:], True)
  assert np.allclose((ended[0] - place.ended)[inner], change * ends[inner][..., 0], atol=1e-2)


def test_a_refit_finds_the_parameter_and_leaves_white_residuals(prepared):
  twin, readings, noise = prepared
  names = ("cornering_stiffness_front", "cornering_stiffness_rear", "mass", "torque_per_volt", "driveline_friction")
  free = ParameterSet([twin.parameters[n] for n in names])
  found = refit(twin, readings, noise, free, twin.parameters.nominal, readings.starts, steps=5)
  truth = SHIFTED * CAR.cornering_stiffness_front
  value, std = found.values[0], found.std[0]
  assert abs(value - truth) < 3.5 * std
  assert std < 0.03 * truth
  chi = np.sum(found.white.rows(0) ** 2) / readings.used.sum()
  assert 0.85 < chi < 1.1
  assert found.noise.value("force_x") < 0.06  # N: nothing pushed this car


def test_a_name_is_one_option_for_each_of_its_starts(prepared):
  twin, readings, _ = prepared
  asked = options(select(["battery_sag", "steering_offset"]), twin.base, readings)
  assert [o.name for o in asked].count("battery_sag") == 2
  freed = asked[-1].freed(twin.base)
  assert set(freed.names) == set(twin.base.names) | {"steering_offset"}


def test_a_jump_of_the_pose_is_stray_and_a_turn_is_not():
  run = recordings()[0]
  assert stray_poses(run).sum() == 0
  table = {name: run[name].value.copy() for name in ("pose_x", "pose_y", "pose_yaw")}
  table["pose_x"][12] += 0.2
  jumped = Recording.from_columns("c", run["pose_x"].time, table | {
    n: np.interp(run["pose_x"].time, run[n].time, run[n].value) for n in ("motor_voltage", "steering_command")
  }, file="c.csv")  # fmt: skip
  assert np.flatnonzero(stray_poses(jumped)).tolist() == [12]
