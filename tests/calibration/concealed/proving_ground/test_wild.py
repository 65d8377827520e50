"""Wild sessions: cars far from the QCar that can still be driven, decided by their seed."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.concealed.campaign.cases import draw_cases, draw_wild_cases
from calibration.concealed.laboratory.designs import DESIGNS
from calibration.concealed.laboratory.manoeuvres import SPACING, oval
from calibration.concealed.laboratory.written import stream
from calibration.concealed.proving_ground import EFFECTS, Car, ProvingGroundPlant, Spec, make_session, make_sessions
from calibration.concealed.proving_ground.drivetrain import LIMIT, Drivetrain
from calibration.concealed.proving_ground.sensing import Sensors
from calibration.concealed.proving_ground.wild import DESIGN, POOLS, draw_wild_car, draw_wild_sensors, scaled
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from tests.calibration.concealed.proving_ground.comparing import same

CASES = draw_wild_cases(3, 60)


@pytest.fixture(scope="module")
def sessions():
  return make_sessions([Spec(c.seed, c.effects, c.design, c.noise) for c in CASES[:3]])


def test_cars_span_what_was_asked_for():
  cars = [draw_wild_car(stream(seed, 0)) for seed in range(200)]
  masses, locks = ([getattr(c, name) for c in cars] for name in ("mass", "max_steering"))
  assert min(masses) < 0.6 and max(masses) > 3.7 and min(locks) < 0.33 and max(locks) > 0.57
  assert {c.drivetrain.command for c in cars} == {"voltage", "duty"}
  sensors = [draw_wild_sensors(stream(seed, 7)) for seed in range(50)]
  assert {s.pose_every for s in sensors} == {1, 10} and {s.speed_every for s in sensors} == {1, 10}


def test_a_case_has_four_to_eight_effects_of_different_kinds():
  for case in CASES:
    names = [name for name, _ in case.effects]
    assert 4 <= len(names) <= 8 and len(set(names)) == len(names)
    for pool, _, _ in POOLS:
      assert sum(name in pool for name in names) <= 1
    assert all(size > 0.0 or EFFECTS[name].signed for name, size in case.effects)
  drawn = {name for case in CASES for name, _ in case.effects}
  assert {"steering_saturation", "drive_chopped", "session_trim"} <= drawn and len(drawn) > 20


def test_wild_effects_are_of_wild_cases_only():
  wild = {name for name, kind in EFFECTS.items() if kind.wild}
  ordinary = draw_cases(5, 0, 0, 0, 40)
  assert wild and not wild & {name for case in ordinary for name, _ in case.effects}


@pytest.mark.slow
def test_the_seed_decides_everything(monkeypatch):
  monkeypatch.setitem(DESIGNS, DESIGN, DESIGNS["tiny"])
  specs = [Spec(c.seed, c.effects, c.design, c.noise) for c in CASES[:2]]
  again = make_session(specs[1].seed, specs[1].effects, specs[1].design, specs[1].noise)
  assert same(again, make_sessions(specs)[1])


@pytest.mark.slow
def test_they_drive_far_fast_and_stay_cars(sessions, tmp_path):
  for case, session in zip(CASES[:3], sessions, strict=True):
    motion = np.concatenate(list(session.clean.values()))
    assert np.isfinite(motion).all()
    assert 1.0 < np.abs(motion[:, 3]).max() < 8.0 and 2.0 < np.percentile(np.abs(motion[:, 7]), 99.9) < 20.0
    assert "motor_constant" not in session.vehicle and session.truth["sensors"]["pose_every"] in (1, 10)
    folder = tmp_path / case.name
    write_dataset(folder, case.name, session.vehicle, session.vehicle_std, session.recordings)
    assert len(DataSet.load(folder).recordings) == len(session.recordings)


@pytest.mark.slow
def test_a_slow_encoder_speaks_ten_times_a_second(sessions):
  for session in sessions:
    every = session.truth["sensors"]["speed_every"]
    assert np.median(np.diff(session.recordings[1]["motor_speed"].time)) == pytest.approx(0.01 * every)


def test_manoeuvres_grow_with_the_car():
  car = Car(motor_constant=1.5e-3)
  run = oval(1.0, 5.0, "identify")
  other = scaled(run, car)
  pace = other.speed[0] / run.speed[0]
  assert pace > 1.2 and np.abs(other.volts).max() <= LIMIT["voltage"]
  steps = np.hypot(np.diff(other.path.x), np.diff(other.path.y))
  assert np.median(steps) == pytest.approx(SPACING, rel=0.02)
  assert np.abs(other.path.curvature).max() == pytest.approx(np.abs(run.path.curvature).max() / pace, rel=0.02)


def drive(effects, commands, ticks, car=None):
  """Signals (N, 10) of cars from rest, side by side, after so many ticks of commands (N, 2)."""
  plant = ProvingGroundPlant(car or Car(copper=0.0, discharge=0.0), effects)
  run = plant.begin(np.zeros((len(commands), 7)))
  for _ in range(ticks):
    run.step(np.array(commands))
  return run.signals


def test_a_steering_saturation_is_steeper_about_the_middle_and_flat_at_lock_on_each_side_in_its_own_way():
  small, large = 0.05, 0.52
  commands = [(0.8, u) for u in (small, -small, large, -large)]
  left, right, left_lock, right_lock = drive((("steering_saturation", 1.5),), commands, 100)[:, 9]
  assert left > 1.2 * small and -right > 1.1 * small
  assert left_lock < 0.36 and -right_lock < 0.26 and left_lock > -right_lock


def test_a_chopped_supply_lets_the_motor_run_faster_at_part_of_it_and_the_same_at_all_of_it():
  volts, effect = [(1.0, 0.0), (4.0, 0.0)], (("drive_chopped", 1.0),)
  (usual, full), (chopped, same_) = (drive(effects, volts, 150)[:, 8] for effects in ((), effect))
  assert chopped > 1.5 * usual
  assert same_ == pytest.approx(full, rel=1e-6)
  duty = Car(copper=0.0, discharge=0.0, drivetrain=Drivetrain(command="duty", supply=4.0))
  assert drive(effect, [(0.25, 0.0)], 150, duty)[0, 8] == pytest.approx(chopped, rel=1e-3)


def test_the_trim_of_the_second_session_is_another():
  effect = EFFECTS["session_trim"](-1.0, slice(1, 6), np.random.default_rng(0))
  sim = SimpleNamespace(road=np.zeros(7))
  effect.begin(sim)
  effect.link(sim)
  np.testing.assert_allclose(sim.road, effect.typical * np.array([0.0, -1.0, -1.0, -1.0, 0.6, 0.6, 0.0]))


def test_ordinary_sessions_have_ordinary_sensors():
  assert Sensors().described() == {"pose_every": 10, "pose_noise": 1.0, "speed_every": 1, "speed_late": 0.0}
