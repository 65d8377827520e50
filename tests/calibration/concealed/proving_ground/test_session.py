"""Sessions: reproducible, complete, saved and read back, with a truth that fits them."""

import ast
import dataclasses
import json
import sys

import numpy as np
import pytest

from calibration.concealed.laboratory.designs import DEGREES, DESIGNS, VOLTS, plan
from calibration.concealed.laboratory.written import save, stream
from calibration.concealed.proving_ground import Car, Spec, make_session, make_sessions
from calibration.concealed.proving_ground.gaps import gaps
from calibration.concealed.proving_ground.long_session import make_long_session
from qcar_twin.recordings.dataset import DataSet
from tests import ROOT
from tests.calibration.concealed.proving_ground.ablation import ABLATIONS, ablate
from tests.calibration.concealed.proving_ground.comparing import differences, same

NOTHING_MORE = {
  "numpy",
  "scipy",
  "qcar_twin.recordings.recording",
  "qcar_twin.recordings.dataset",
  "qcar_twin.atomic_io",
  "qcar_twin.untrusted",
  "__future__",
}


@pytest.fixture(scope="module")
def session():
  return make_session(11, (("steering_delay", 1.0), ("payload", 0.5)), "tiny")


def test_the_proving_ground_imports_nothing_of_the_twin():
  """But for `onboard.py`, which offers it to scripts for the real car."""
  folder = ROOT / "calibration" / "concealed" / "proving_ground"
  files = [file for file in folder.rglob("*.py") if file.name != "onboard.py"]
  assert len(files) > 15
  for file in files:
    for node in ast.walk(ast.parse(file.read_text())):
      names = []
      if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
      elif isinstance(node, ast.ImportFrom) and not node.level:
        names = [node.module]
      for name in names:
        allowed = name in NOTHING_MORE or name.split(".")[0] in {"numpy", "scipy", *sys.stdlib_module_names}
        allowed |= name.startswith(("calibration.concealed.laboratory.", "calibration.concealed.proving_ground."))
        assert allowed, f"{file.name} imports {name}"


def test_the_same_seed_gives_the_same_session_bit_for_bit(session):
  again = make_session(11, (("steering_delay", 1.0), ("payload", 0.5)), "tiny")
  assert same(session, again)
  assert again.truth == session.truth
  assert again.vehicle == session.vehicle


def test_another_seed_gives_another_car_and_another_session(session):
  other = make_session(12, (), "tiny")
  assert not same(session, other)
  assert other.truth["car"]["mass"] != session.truth["car"]["mass"]


def test_a_session_does_not_depend_on_its_neighbours(session):
  effects = (("steering_delay", 1.0), ("payload", 0.5))
  neighbours = [
    Spec(1, (("driveline_backlash", 1.0),), "tiny"),
    Spec(11, effects, "tiny"),
    Spec(2, (("cogging", 2.0),), "compact"),
  ]
  assert same(session, make_sessions(neighbours[:2] + [Spec(5, (), "tiny")])[1])


@pytest.mark.slow
def test_a_long_list_of_sessions_is_cut_into_pieces(monkeypatch, session):
  monkeypatch.setattr("calibration.concealed.proving_ground.session.WIDEST", 1000)
  made = make_sessions(
    [Spec(11, (("steering_delay", 1.0), ("payload", 0.5)), "tiny"), Spec(3, (), "tiny"), Spec(4, (), "tiny")]
  )
  assert len(made) == 3
  assert same(session, made[0])


def test_an_effect_moves_neither_car_nor_noise():
  bare, hidden = make_sessions([Spec(3, e, "tiny") for e in ((), (("gyro_bias", 1.0),))])
  assert bare.vehicle == hidden.vehicle
  change = differences(bare, hidden)
  assert change["yaw_rate"] == pytest.approx(0.03, abs=1e-4)
  assert all(value == 0.0 for channel, value in change.items() if channel != "yaw_rate")


def test_streams_of_topics_are_independent():
  assert stream(1, 2).random() == stream(1, 2).random()
  assert len({stream(seed, topic).random() for seed in range(3) for topic in range(3)}) == 9


def test_noise_scales_with_its_level():
  quiet, normal, loud = make_sessions([Spec(3, (), "tiny", level) for level in (0.0, 1.0, 2.0)])
  still = [s.recordings[0]["accel_x"].value[:15] for s in (quiet, normal, loud)]
  assert np.all(still[0] == 0.0)
  assert still[2] == pytest.approx(2 * still[1], abs=2e-3)


@pytest.mark.parametrize("design", ["lab", "compact", "paper"])
def test_a_design_has_every_role_and_names_once(design):
  runs = plan(design, np.random.default_rng(0))
  assert {run.role for run in runs} == {"identify", "validate", "holdout"}
  assert len({run.name for run in runs}) == len(runs)
  assert {run.session for run in runs} == {"morning", "afternoon"}
  for run in runs:
    assert run.steer.shape == run.speed.shape == run.volts.shape == (run.ticks,)


def test_the_designs_are_as_long_as_they_should_be():
  seconds = {
    name: 0.01 * sum(run.ticks for run in plan(name, np.random.default_rng(0))) for name in ("lab", "compact", "paper")
  }
  assert 270 < seconds["lab"] < 330
  assert 100 < seconds["compact"] < 135
  assert len(plan("compact", np.random.default_rng(0))) in (12, 13, 14, 15)


@pytest.mark.parametrize("design", ["lab", "paper"])
def test_the_papers_steps_are_all_there(design):
  runs = {run.name: run for run in plan(design, np.random.default_rng(0))}
  for role, levels in VOLTS.items():
    assert all(
      runs[f"voltage_step_{v:g}V"].role == role and runs[f"voltage_step_{v:g}V"].volts[-1] == v for v in levels
    )
  for role, levels in DEGREES.items():
    assert all(np.rad2deg(runs[f"steering_step_{d:g}deg"].steer[-1]) == pytest.approx(d) for d in levels)
    assert all(runs[f"steering_step_{d:g}deg"].role == role for d in levels)


def test_an_unknown_design_is_refused():
  with pytest.raises(KeyError, match="valid are.*lab.*compact.*paper"):
    plan("laboratory", np.random.default_rng(0))
  with pytest.raises(KeyError, match="no session design 'labb'; did you mean 'lab'?"):
    plan("labb", np.random.default_rng(0))


def test_recordings_have_the_channels_at_their_rates(session):
  for recording in session.recordings:
    assert set(recording.channels) == {
      "motor_voltage", "steering_command", "motor_speed", "accel_x", "accel_y", "yaw_rate",
      "pose_x", "pose_y", "pose_yaw", "pose_score",
    }  # fmt: skip
    assert np.diff(recording["yaw_rate"].time) == pytest.approx(0.01)
    assert np.diff(recording["pose_x"].time) == pytest.approx(0.1)
    assert np.all(np.abs(recording["steering_command"].value) <= session.vehicle["max_steering"] + 1e-4)


def test_the_logged_command_acts_after_the_measurement_of_its_row():
  """A voltage step from rest moves the encoder in the row after the step, not in its own."""
  step = make_session(2, (), "tiny", 0.0).recordings[1]
  first = np.flatnonzero(step["motor_voltage"].value)[0]
  speed = step["motor_speed"].value
  assert np.all(speed[: first + 1] == 0.0)
  assert speed[first + 1] > 1.0


def test_measured_vehicle_is_near_the_truth_within_its_deviations():
  z = []
  for seed in range(40):
    car = Car.draw(np.random.default_rng([seed, 0]))
    value, std = car.measured(np.random.default_rng([seed, 1]))
    z += [(value[name] - getattr(car, name)) / std[name] for name in std if name != "cg_to_rear"]
    assert value["cg_to_front"] + value["cg_to_rear"] == pytest.approx(car.wheelbase, abs=1.1e-3)
    assert value["gear_ratio"] == car.gear_ratio
  assert np.max(np.abs(z)) <= 2.0 + 1e-9
  assert np.std(z) == pytest.approx(0.95, abs=0.1)


def test_cars_are_of_the_qcars_kind():
  for seed in range(40):
    car = Car.draw(np.random.default_rng(seed))
    line = car.linearised()
    assert 2.0 <= car.mass <= 3.3
    assert 0.24 <= car.wheelbase <= 0.275
    top = (line["P1"] * 2.5 - line["P3"]) / line["P2"] * car.gear_ratio * car.wheel_radius
    assert 1.8 < top < 3.2
    assert 80 < line["cornering_stiffness_front"] < 230
    rear, front = line["cornering_stiffness_rear"], line["cornering_stiffness_front"]
    understeer = car.cg_to_rear / front - car.cg_to_front / rear
    assert car.wheelbase + car.mass / car.wheelbase * understeer * 2.5**2 > 0  # no oversteer instability below 2.5 m/s


def test_the_truth_is_complete_and_plain_json(session):
  truth = json.loads(json.dumps(session.truth))
  assert [effect["id"] for effect in truth["effects"]] == ["steering_delay", "payload"]
  assert truth["effects"][0]["parameters"]["steering_delay"] == pytest.approx(0.040)
  assert truth["effects"][1]["size"] == 0.5
  assert set(truth["linearised"]) == {"P1", "P2", "P3", "cornering_stiffness_front", "cornering_stiffness_rear"}
  assert truth["car_as_driven"]["mass"] == pytest.approx(truth["car"]["mass"] + 0.275)
  assert len(truth["gaps"]) >= 9
  assert session.clean["excitation"].shape == (200, len(truth["signals"]))


def test_a_given_car_is_used():
  car = dataclasses.replace(Car(), mass=2.22)
  assert make_session(0, (), "tiny", car=car).truth["car"]["mass"] == 2.22


def test_a_session_saved_is_the_session_read(tmp_path, session):
  save(session, tmp_path / "data", "tiny", "abc123")
  data = DataSet.load(tmp_path / "data")
  assert "abc123" in data.description
  assert data.command_timing == "after_measurement"
  assert data.vehicle["mass"] == pytest.approx(session.vehicle["mass"], rel=1e-5)
  assert data.vehicle_std["imu_x"] == pytest.approx(0.003)
  for a, b in zip(session.recordings, data.recordings, strict=True):
    assert (a.name, a.role, a.manoeuvre, a.session) == (b.name, b.role, b.manoeuvre, b.session)
    assert all(b[c].value == pytest.approx(a[c].value, abs=1e-9) for c in a.channels)


def test_heat_and_charge_are_carried_from_run_to_run():
  """The last run of a session starts warmer: a repeated step is slower than in a session that consists of it alone."""
  one, two = DESIGNS["tiny"](np.random.default_rng(0)), DESIGNS["tiny"](np.random.default_rng(0))
  again = dataclasses.replace(two[2], name="again")
  DESIGNS["repeat"] = lambda rng: [one[2], *[dataclasses.replace(one[3], name=f"work_{i}") for i in range(12)], again]
  try:
    repeated = make_session(3, (("motor_heating", 2.0),), "repeat", 0.0)
  finally:
    del DESIGNS["repeat"]
  first, last = (np.abs(repeated.clean[name][:, 8]).mean() for name in ("excitation", "again"))
  assert abs(last / first - 1) > 0.01


def test_closing_a_gap_changes_little():
  sizes = ablate(0, "tiny")
  assert set(sizes) == set(ABLATIONS)
  assert max(max(channels.values()) for channels in sizes.values()) < 4.0
  assert all("value" in gap or gap["gap"] for gap in gaps(Car()))


@pytest.mark.slow
def test_sessions_of_one_car_make_a_long_log():
  long = make_long_session(Spec(5, (("steering_delay", 1.0),), "tiny", 1.0), 3)
  one = make_session(5, (("steering_delay", 1.0),), "tiny", 1.0)
  count = len(one.recordings)
  assert len(long.recordings) == 3 * count == len({r.name for r in long.recordings}) == len(long.clean)
  assert long.vehicle == one.vehicle and long.truth == one.truth
  for mine, other in zip(long.recordings, one.recordings, strict=False):
    assert mine.name == other.name and np.array_equal(mine["yaw_rate"].value, other["yaw_rate"].value)
  second = long.recordings[count]
  assert second.name == f"{one.recordings[0].name}_2" and second.session.endswith(" 2")
  assert not np.array_equal(second["yaw_rate"].value, one.recordings[0]["yaw_rate"].value)
