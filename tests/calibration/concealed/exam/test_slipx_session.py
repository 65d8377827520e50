"""A session of slipx's car: the seed decides every bit, the log is what the car did and fit to be used."""

import numpy as np
import pytest

from calibration.concealed.exam.generator import FINE, SIGNALS, MissingGenerator, Start, load_package
from calibration.concealed.exam.sensing import AVERAGED, averaged
from calibration.concealed.exam.session import make_exam_session
from calibration.concealed.exam.slipx_car import GEAR, SlipxCar
from scripts import check
from scripts import make_exam_session as make_exam_session_command
from tests.calibration.concealed.proving_ground.comparing import same


@pytest.fixture(scope="module")
def session():
  pytest.importorskip("slipx", reason="slipx is not installed (extra `exam`)")
  return make_exam_session("slipx", 1)


def test_the_seed_decides_every_bit(session):
  again, other = make_exam_session("slipx", 1), make_exam_session("slipx", 2)
  assert same(session, again) and session.truth == again.truth
  assert session.vehicle != other.vehicle
  assert session.truth["effects"] == [] and session.truth["car"]["generator"] == "slipx"


def test_without_noise_the_recordings_are_the_true_signals(session):
  quiet = make_exam_session("slipx", 1, noise=0.0)
  for recording in quiet.recordings:
    clean = dict(zip(SIGNALS, quiet.clean[recording.name].T, strict=True))
    assert recording["motor_speed"].value == pytest.approx(clean["motor"], abs=0.006)
    assert recording["pose_x"].value == pytest.approx(clean["x"][::4], abs=6e-5)
    turning = np.gradient(clean["yaw"], 0.01)
    assert np.abs(turning - clean["yaw_rate"])[5:-5].max() < 0.02 * np.abs(turning).max() + 1e-3


def test_a_straight_run_obeys_newton():
  pytest.importorskip("slipx", reason="slipx is not installed (extra `exam`)")
  car = SlipxCar(np.random.default_rng(0))
  plant, p = car.plant(), car.params
  plant.start(Start(0.0, 0.0, 0.0, 1.0))
  trace = np.concatenate([plant.advance(10.0, 0.0) for _ in range(50)])
  speed, accel = trace[:, 3], trace[:, 6]
  assert np.ptp(trace[:, 1]) < 1e-9
  driving = 10.0 * p.torque_per_amp / p.wheel_radius - p.drag_coeff * speed**2
  assert accel[FINE:] * p.mass == pytest.approx((driving - p.roll_resist * 9.81 * p.mass)[FINE:], rel=0.03)
  assert trace[-1, 8] * GEAR * p.wheel_radius > speed[-1], "driven wheels slip"


@pytest.mark.parametrize(("speed", "angle"), [(1.2, 0.3), (1.8, 0.17)])
def test_in_a_turn_the_wheels_forces_make_the_motion(speed, angle):
  pytest.importorskip("slipx", reason="slipx is not installed (extra `exam`)")
  car = SlipxCar(np.random.default_rng(0))
  plant, p = car.plant(), car.params
  plant.start(Start(0.0, 0.0, 0.0, speed))
  trace = np.concatenate([plant.advance(3.0, angle) for _ in range(60)])
  forward, aside, steered = (np.array(v) for v in (plant.seen.fx, plant.seen.fy, [plant.state.steer] * 2 + [0.0] * 2))
  resistance = p.roll_resist * p.mass * 9.81 + p.drag_coeff * trace[-1, 3] ** 2
  along = (forward * np.cos(steered) - aside * np.sin(steered)).sum() - resistance
  across = (forward * np.sin(steered) + aside * np.cos(steered)).sum()
  change = (trace[-1] - trace[-2]) * 1000.0  # per second
  moved = (change[3] - trace[-1, 4] * trace[-1, 5], change[4] + trace[-1, 3] * trace[-1, 5])
  assert (along, across) == pytest.approx(p.mass * np.array(moved), abs=0.03)
  assert abs(across) > 3.0


def test_a_slow_car_turns_no_sharper_than_its_front_wheels_point():
  pytest.importorskip("slipx", reason="slipx is not installed (extra `exam`)")
  car = SlipxCar(np.random.default_rng(0))
  plant, p = car.plant(), car.params
  plant.start(Start(0.0, 0.0, 0.0, 0.4))
  trace = np.concatenate([plant.advance(0.8, 0.3) for _ in range(60)])
  pointed = trace[-1, 3] * np.tan(0.3) / (p.lf + p.lr)
  assert 0.1 < trace[-1, 3] < 0.5
  assert 0.85 * pointed < trace[-1, 5] < 1.01 * pointed


def test_the_inertial_sensor_averages_what_has_been():
  step = np.repeat([0.0, 1.0], 20)
  assert averaged(step)[20 : 20 + AVERAGED] == pytest.approx(np.arange(1, AVERAGED + 1) / AVERAGED)
  assert averaged(step)[:20].max() == 0.0


def test_the_written_session_is_fit_to_be_used(tmp_path, capsys):
  pytest.importorskip("slipx", reason="slipx is not installed (extra `exam`)")
  data = make_exam_session_command.main(make_exam_session_command.Config(tmp_path / "data", seed=1))
  assert len(data.recordings) == 12 and not list((tmp_path / "data").glob("truth.json"))
  check.main(check.Config(dataset=tmp_path / "data", out=tmp_path / "checked"))
  assert "Fit to be used" in capsys.readouterr().out


def test_an_unknown_or_missing_generator_is_named():
  with pytest.raises(KeyError, match="valid are: slipx, commonroad, commonroad_full, exudyn"):
    make_exam_session("carla", 0)
  with pytest.raises(MissingGenerator, match=r"qcar-twin\[exam\]"):
    load_package("no_such_simulator", "no-such-simulator")
