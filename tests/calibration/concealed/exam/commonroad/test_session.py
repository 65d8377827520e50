"""A session of each size is decided by its seed, rolls throughout, and is fit to be used."""

import numpy as np
import pytest

from calibration.concealed.exam.commonroad.car import CommonroadCar
from calibration.concealed.exam.commonroad.driver import RoadDriver
from calibration.concealed.exam.commonroad.runs import rolling, stretched
from calibration.concealed.exam.effects import Concealed
from calibration.concealed.exam.generator import Start
from calibration.concealed.exam.session import GENERATORS, make_exam_session, replayed, set_up
from scripts import check
from scripts import make_exam_session as make_exam_session_command

NAMES = ("commonroad", "commonroad_full")


def test_manoeuvres_of_a_larger_car_are_the_same_but_for_their_units():
  small, large = (rolling(np.random.default_rng(1), k, a) for k, a in ((1.0, 1.0), (4.0, 10.0)))
  for one, other in zip(small, large, strict=True):
    assert (one.name, one.role, one.session) == (other.name, other.role, other.session)
    assert other.ticks == 2 * one.ticks and other.start[3] == pytest.approx(2.0 * one.start[3])
    assert other.steer[::2] == pytest.approx(one.steer) and other.volts[::2] == pytest.approx(10.0 * one.volts)
    assert np.nanmax(other.speed, initial=0.0) == pytest.approx(2.0 * np.nanmax(one.speed, initial=0.0))
  assert {run.role for run in small} == {"identify", "validate", "holdout"}
  assert stretched(small[0], 1.0, 1.0).volts == pytest.approx(small[0].volts)


@pytest.mark.parametrize("name", NAMES)
def test_the_driver_keeps_to_the_line(name):
  pytest.importorskip("vehiclemodels", reason="commonroad-vehicle-models is not installed (extra `exam`)")
  setting = set_up(name, 4)
  long = setting.car.size.length
  index = next(i for i, run in enumerate(setting.runs) if run.name == "oval")
  run, plant = setting.runs[index], setting.car.plant()

  seen, driver = (
    plant.start(Start(*run.start)),
    RoadDriver([run], setting.shaking[:, :, index : index + 1], setting.beliefs),
  )
  off, speeds = [], []
  for k in range(run.ticks):
    told = driver.commands(k, seen[None, 0], seen[None, 1], seen[None, 2], seen[None, 8])[:, 0]
    seen = plant.advance(*told)[-1]
    off.append(np.hypot(run.path.x - seen[0], run.path.y - seen[1]).min())
    speeds.append(seen[3])
  assert max(off) < 0.3 * long and np.median(speeds) == pytest.approx(run.speed[0], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_session_without_an_effect_is_fit_to_be_used(name, tmp_path, capsys):
  pytest.importorskip("vehiclemodels", reason="commonroad-vehicle-models is not installed (extra `exam`)")
  data = make_exam_session_command.main(make_exam_session_command.Config(tmp_path / "data", name, seed=1))
  assert len(data.recordings) == 13
  slowest = min(float(recording["motor_speed"].value.min()) for recording in data.recordings)
  assert slowest * 0.1 * data.vehicle["wheel_radius"] > 0.2 * np.sqrt(GENERATORS[name].size.length), "it never stands"
  check.main(check.Config(dataset=tmp_path / "data", out=tmp_path / "checked"))
  assert "Fit to be used" in capsys.readouterr().out


def test_each_own_effect_changes_the_run():
  pytest.importorskip("vehiclemodels", reason="commonroad-vehicle-models is not installed (extra `exam`)")

  setting = set_up("commonroad", 5)
  run = setting.runs[3]
  commands = np.stack([4.0 * np.sin(np.arange(80) / 9.0) - 1.0, 0.35 * np.sin(np.arange(80) / 7.0)], axis=1)
  afternoon = type(run)(**{**vars(run), "session": "afternoon"})
  plain = replayed(setting.car, afternoon, commands)
  for name, effect in setting.car.effects.items():
    size = 0.3 * effect.most
    changed = replayed(setting.car, afternoon, commands, [Concealed(name, effect, size)])
    assert np.isfinite(changed).all() and np.abs(changed - plain).max() > 1e-4, name


def test_the_seed_decides_every_bit(monkeypatch):
  pytest.importorskip("vehiclemodels", reason="commonroad-vehicle-models is not installed (extra `exam`)")
  whole = CommonroadCar.runs
  monkeypatch.setattr(CommonroadCar, "runs", lambda car, rng: whole(car, rng)[::6])
  one, same = (make_exam_session("commonroad", 2) for _ in range(2))
  values = lambda s: np.concatenate([r["yaw_rate"].value for r in s.recordings])
  assert np.array_equal(values(one), values(same)) and one.truth == same.truth
  assert one.vehicle != set_up("commonroad", 3).vehicle and one.truth["car"]["parameters"] == "vehicle 2"
