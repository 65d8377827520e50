"""The fleet: independence of cars, restarts that leave no trace, ends, mismatch, demonstrator, randomisation."""

import numpy as np
import pytest

from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.envs.car_batch import BicycleBatch, SeparateCars, TwinBatch, car_batch
from qcar_twin.envs.fleet import Spread
from qcar_twin.paths import path_from_pieces
from qcar_twin.plant import signal_index
from qcar_twin.twin.mechanisms import select
from tests.qcar_twin.envs.fleet_rig import BICYCLE, VEHICLE, actions, make_fleet, twin

ALL = np.ones(1, dtype=bool)


def run(fleet, rates):
  """Signals and observations of a fleet under rates (T, N), restarting whoever is done."""
  signals, seen, rewards = [], [], []
  for rate in rates:
    outcome = fleet.step(rate)
    rewards.append(outcome.reward)
    fleet.restart(outcome.terminated | outcome.truncated)
    signals.append(fleet.signals.copy())
    seen.append(fleet.observation.copy())
  return np.stack(signals), np.stack(seen), np.stack(rewards)


# -- speeds --------------------------------------------------------------------------------------


def test_every_episode_has_a_speed_of_its_own_and_holds_it():
  cars = make_fleet(range(40), "bicycle", sensed=False, speed=0.9, speed_spread=0.6)
  first = cars.cars.target.copy()
  assert 0.3 <= first.min() < 0.5 and 1.3 < first.max() <= 1.5
  np.testing.assert_allclose(cars.signals[:, signal_index("velocity_x")], first)
  for _ in range(60):
    cars.step(np.zeros(40))
  np.testing.assert_allclose(cars.signals[:, signal_index("velocity_x")], first, rtol=0.15)
  cars.restart(np.arange(40) < 20)
  assert np.all(cars.cars.target[:20] != first[:20]) and np.all(cars.cars.target[20:] == first[20:])


def test_without_a_spread_no_speed_is_drawn_and_a_spread_past_standstill_is_refused():
  plain, spread = (make_fleet([3], "bicycle", sensed=False, speed_spread=x) for x in (0.0, 0.1))
  assert plain.cars.target[0] == 0.5 != spread.cars.target[0] and plain.task.longest < spread.task.longest
  with pytest.raises(ValueError, match="from 0 on and less than the speed"):
    make_fleet([3], "bicycle", sensed=False, speed_spread=0.5)


# -- batches of cars -----------------------------------------------------------------------------


def starts(count, seed=0):
  rng = np.random.default_rng(seed)
  out = rng.uniform(-0.1, 0.1, (count, 7))
  out[:, 3] = rng.uniform(0.3, 0.8, count)
  return out


def batch_of(kind, theta, start):
  if kind == "separate":
    return SeparateCars(lambda: Bicycle(VEHICLE), theta, start)
  made = car_batch(twin if kind == "twin" else lambda: Bicycle(VEHICLE), theta, start)
  assert isinstance(made, TwinBatch if kind == "twin" else BicycleBatch)
  return made


@pytest.mark.parametrize("kind", ["twin", "bicycle", "separate"])
def test_a_restarted_car_drives_like_a_fresh_one_and_the_others_drive_on(kind):
  nominal = (twin() if kind == "twin" else BICYCLE).parameters.nominal
  theta, start, again = np.tile(nominal, (3, 1)), starts(3), starts(3, seed=1)
  commands = np.random.default_rng(2).uniform([0.3, -0.3], [1.2, 0.3], (60, 3, 2))
  untouched, restarted = batch_of(kind, theta, start), batch_of(kind, theta, start)
  fresh = batch_of(kind, theta, again)
  for k in range(20):
    untouched.step(commands[k])
    restarted.step(commands[k])
  restarted.restart(np.array([False, True, False]), theta, again)
  np.testing.assert_array_equal(restarted.signals[1], fresh.signals[1])
  for k in range(20, 60):
    a, b, c = untouched.step(commands[k]), restarted.step(commands[k]), fresh.step(commands[k])
    np.testing.assert_array_equal(b[[0, 2]], a[[0, 2]])
    np.testing.assert_array_equal(b[1], c[1])


@pytest.mark.parametrize("kind", ["twin", "bicycle"])
def test_restart_with_other_parameters(kind):
  parameters = (twin() if kind == "twin" else BICYCLE).parameters
  soft = parameters.nominal.copy()
  for name in ("cornering_stiffness_front", "cornering_stiffness_rear"):
    soft[parameters.index(name)] *= 0.5
  if kind == "twin":
    soft[parameters.index("mass")] *= 1.2
  start = starts(2)
  theta = np.stack([parameters.nominal, soft])
  restarted = batch_of(kind, np.tile(parameters.nominal, (2, 1)), start)
  command = np.array([[0.8, 0.2], [0.8, 0.2]])
  restarted.step(command)
  restarted.restart(np.array([False, True]), theta, start)
  fresh = batch_of(kind, theta, start)
  for _ in range(30):
    b, c = restarted.step(command), fresh.step(command)
  np.testing.assert_allclose(b[1], c[1], rtol=0.0, atol=1e-14)
  assert abs(b[1, 2] - b[0, 2]) > 1e-4


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_mechanisms_are_restarted_with_their_cars(engine):
  """Hidden state, time since the start and what was written into the simulator; a mechanism may come and go."""
  names = ("steering_delay", "steering_backlash", "battery_sag", "friction_change", "friction_patch", "payload")
  mechanisms = select(names)
  make = lambda: twin().on(engine).with_mechanisms(mechanisms)
  nominal, parameters = make().parameters.nominal, make().parameters
  effect = nominal.copy()
  for p in (p for m in mechanisms for p in m.parameters if p.null is not None):
    effect[parameters.index(p.name)] = p.null + p.typical
  theta, start, again = np.stack([effect, nominal, effect]), starts(3), starts(3, seed=1)
  after = np.stack([effect, effect, nominal])
  which = np.array([False, True, True])
  commands = np.random.default_rng(2).uniform([0.3, -0.3], [1.2, 0.3], (80, 3, 2))
  untouched, restarted, fresh = (car_batch(make, *given) for given in ((theta, start), (theta, start), (after, again)))
  assert isinstance(restarted, TwinBatch)
  for command in commands[:40]:
    untouched.step(command)
    restarted.step(command)
  restarted.restart(which, after, again)
  for command in commands[40:]:
    a, b, c = untouched.step(command), restarted.step(command), fresh.step(command)
    np.testing.assert_array_equal(b[0], a[0])
    np.testing.assert_allclose(b[1:], c[1:], rtol=1e-12, atol=1e-12)
  alike = car_batch(make, np.stack([nominal] * 3), again)
  for command in commands[40:]:
    plain = alike.step(command)
  assert np.abs(plain[1] - b[1]).max() > 1e-3 and np.abs(plain[2] - b[2]).max() < 1e-9


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_a_restarted_car_keeps_neither_the_force_nor_the_turns_of_the_one_before(engine):
  make = lambda: twin().on(engine).with_mechanisms(select(["side_force"]))
  nominal = make().parameters.nominal[None]
  pushed, start, command = nominal.copy(), np.zeros((1, 7)), np.array([[1.5, 0.4]])
  pushed[0, make().parameters.index("side_force")] = 3.0
  start[0, 3] = 1.0
  restarted, fresh = (car_batch(make, theta, start) for theta in (pushed, nominal))
  for _ in range(350):
    assert np.isfinite(restarted.step(command)).all()
  assert restarted.signals[0, signal_index("pose_yaw")] > 2.0 * np.pi
  restarted.restart(ALL, nominal, start)
  for _ in range(30):
    np.testing.assert_allclose(restarted.step(command), fresh.step(command), rtol=1e-12, atol=1e-12)


# -- fleet ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("plant", "sensed"), [("twin", True), ("bicycle", True), ("twin", False)])
def test_a_car_drives_bit_for_bit_the_same_whoever_drives_beside_it(plant, sensed):
  rates = actions(150, 3)
  together = run(make_fleet([5, 6, 7], plant, sensed, lost=0.08), rates)
  alone = run(make_fleet([6], plant, sensed, lost=0.08), rates[:, 1:2])
  for a, b in zip(together, alone, strict=True):
    np.testing.assert_array_equal(a[:, 1], b[:, 0])


def test_a_seed_reproduces_everything_and_another_does_not():
  rates = actions(60, 2)
  first, again, other = (run(make_fleet(seeds), rates)[1] for seeds in ([1, 2], [1, 2], [3, 2]))
  np.testing.assert_array_equal(first, again)
  assert np.abs(first[:, 0] - other[:, 0]).max() > 1e-3
  np.testing.assert_array_equal(first[:, 1], other[:, 1])


def test_seeding_again_is_like_a_fresh_fleet():
  rates = actions(50, 2)
  fleet = make_fleet([1, 2])
  first = run(fleet, rates)[1]
  fleet.seed([1, 2])
  np.testing.assert_array_equal(run(fleet, rates)[1], first)


def test_observation_is_the_estimate_and_the_truth_is_kept_apart():
  fleet = make_fleet([0, 1])
  run(fleet, actions(60, 2))
  true = fleet.task.path.errors(fleet.arc_length[1], fleet.signals[:, :3], fleet.signals[:, 3:5], fleet.signals[:, 5])
  np.testing.assert_array_equal(fleet.cross_track, true.cross_track)
  assert 1e-5 < np.abs(fleet.observation[:, 0] - fleet.cross_track).max() < 0.05
  blind = make_fleet([0, 1], sensed=False)
  run(blind, actions(60, 2))
  np.testing.assert_allclose(blind.observation[:, 0], blind.cross_track, atol=1e-12)


def test_an_episode_ends_where_the_path_ends():
  line = path_from_pieces("line", [(1.0, 0.0, 0.0)])
  fleet = make_fleet([0], sensed=False, start_offset=0.0, start_heading=0.0)
  fleet.task = type(fleet.task)(line, start_offset=0.0, start_heading=0.0)
  fleet.seed([0])
  steps, outcome = 0, None
  while outcome is None or (not outcome.truncated[0] and steps < 300):
    outcome, steps = fleet.step(np.zeros(1)), steps + 1
  assert steps == pytest.approx(200, abs=12) and not outcome.terminated[0]
  assert fleet.arc_length[1, 0] == pytest.approx(1.0, abs=0.01)


def test_a_car_that_leaves_the_path_is_lost_and_pays_once():
  fleet = make_fleet([0], sensed=False)
  rewards = []
  for _ in range(400):
    outcome = fleet.step(np.array([1.5]))
    rewards.append(outcome.reward[0])
    if outcome.terminated[0]:
      break
  assert outcome.terminated[0] and not outcome.truncated[0]
  assert abs(fleet.cross_track[0]) >= 0.2
  assert rewards[-1] < -8.0 < min(rewards[:-1])


def test_time_runs_out_for_a_car_that_stands():
  class Standing:
    def __init__(self, speed):
      pass

    def voltage(self, speed, target, period):
      return np.zeros_like(speed)

  fleet = make_fleet([0], plant="bicycle", sensed=False, start_offset=0.0, start_heading=0.0)
  object.__setattr__(fleet.config, "speed_control", Standing)
  fleet.task = type(fleet.task)(path_from_pieces("line", [(0.5, 0.0, 0.0)]), start_offset=0.0, start_heading=0.0)
  fleet.seed([0])
  ends = [fleet.step(np.zeros(1)).truncated[0] for _ in range(fleet.task.longest)]
  assert ends[-1] and not any(ends[:-1])


def test_steering_is_integrated_and_held_at_the_lock():
  fleet = make_fleet([0], sensed=False)
  for _ in range(10):
    fleet.step(np.array([9.0]))
  assert fleet.steering[0] == pytest.approx(10 * 0.01 * 1.5)
  for _ in range(60):
    fleet.step(np.array([1.5]))
  assert fleet.steering[0] == fleet.task.lock


@pytest.mark.parametrize("plant", ["twin", "bicycle"])
def test_a_wrong_linkage_turns_the_wheels_otherwise_than_commanded(plant):
  fleet = make_fleet([0], plant, sensed=False, steering_gain=0.92, steering_offset=0.0175, start_offset=0.0)
  for _ in range(20):
    fleet.step(np.array([0.5]))
  for _ in range(10):
    fleet.step(np.array([0.0]))
  wheels = fleet.signals[0, signal_index("steering_angle")]
  assert wheels == pytest.approx(0.92 * 0.1 + 0.0175, abs=2e-3)


def test_servo_of_the_task_delays_and_lags_and_restarts_straight():
  fleet = make_fleet([0], "bicycle", sensed=False, servo_delay=0.02, servo_lag=0.04)
  angles = []
  for _ in range(6):
    fleet.step(np.array([1.5]))
    angles.append(fleet.signals[0, signal_index("steering_angle")])
  assert angles[0] == angles[1] == 0.0
  share = 1.0 - np.exp(-0.25)
  assert angles[2] == pytest.approx(share * 0.015)
  assert angles[3] == pytest.approx(share * 0.015 + share * (0.03 - share * 0.015))
  fleet.restart(ALL)
  fleet.step(np.array([1.5]))
  assert fleet.signals[0, signal_index("steering_angle")] == 0.0


def test_demonstrator_pays_for_imitation_and_its_action_is_rate_bounded():
  wanted = lambda errors, speed: np.full_like(speed, 0.1)
  near, far = (make_fleet([0], "bicycle", False, demonstrator=wanted) for _ in range(2))
  alone = make_fleet([0], "bicycle", False)
  assert near.expert_action()[0] == 1.5
  rewards = [fleet.step(np.array([rate])).reward[0] for fleet, rate in ((near, 1.5), (far, -1.5), (alone, 1.5))]
  assert rewards[2] - rewards[0] == pytest.approx(0.5 * (0.1 - 0.015))
  assert rewards[0] - rewards[1] == pytest.approx(0.5 * 0.03, abs=1e-3)
  for _ in range(6):
    near.step(near.expert_action())
  assert near.steering[0] == pytest.approx(0.1) and near.expert_action()[0] == pytest.approx(0.0, abs=1e-12)


def test_parameters_are_drawn_per_episode_with_the_covariance_asked_for():
  names = ("mass", "cornering_stiffness_front")
  spread = Spread(names, np.array([[0.01, 0.5], [0.5, 100.0]]))
  plant = twin()
  rng = np.random.default_rng(0)
  draws = np.stack([spread.draw(plant, plant.parameters.nominal, rng) for _ in range(4000)])
  columns = [plant.parameters.index(name) for name in names]
  np.testing.assert_allclose(np.cov(draws[:, columns].T), spread.covariance, rtol=0.1)
  others = np.delete(draws, columns, axis=1)
  assert np.all(others == others[0])
  fleet = make_fleet([0, 1], sensed=False, spread=spread)
  before = fleet.theta
  fleet.restart(np.array([True, False]))
  assert np.all(fleet.theta[0, columns] != before[0, columns]) and np.all(fleet.theta[1] == before[1])


def test_wrong_number_of_seeds_is_refused():
  with pytest.raises(ValueError, match="3 seeds for 2 cars"):
    make_fleet([0, 1], "bicycle", False).seed([1, 2, 3])
