"""A speed controller in cases worked out by hand, and alike in both engines, held commands with it."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.plant import START, Segments
from qcar_twin.twin.engines import controller
from qcar_twin.twin.engines.controller import BRAKED, FREE, ON_ITS_WAY, at_first
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR

SUPPLY, BACK = 8.0, 1.0  # V
ALL = (1.0, 1.0, 1.0, 0.0, 0.0)  # diodes, chopped braking, open at neutral, a brake of full strength, and a reverse
DUTY_CAR = dataclasses.replace(QCAR, drive="duty", supply_voltage=SUPPLY)
WHOLE = {f"drive_one_way{name}": share for name, share in zip(("", "_brake", "_neutral"), ALL, strict=False)}
FORWARDS = WHOLE | {"drive_one_way_reverse": 1.0}


def acting(shares, commands, back_emf, braked=FREE) -> np.ndarray:
  """What acts of commands that come one after the other, V."""
  out = []
  for command, emf in np.broadcast(commands, back_emf):
    one = lambda value: np.array([float(value)])
    volts, state = controller.acting(one(command), one(emf), one(braked), np.array([shares]).T, SUPPLY)
    braked = float(state[0])
    out.append(float(volts[0]))
  return np.array(out)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_it_does_not_brake_while_it_drives(way):
  volts = acting((1.0, 0.0, 0.0, 0.0, 0.0), way * np.array([0.6, BACK, 3.0]), way * BACK)
  np.testing.assert_allclose(way * volts, [BACK, BACK, 3.0], atol=0.03)


def test_four_quadrants_brake_as_far_as_the_command_is_below_the_back_emf():
  volts = acting((0.5, 0.0, 0.0, 0.0, 0.0), [0.6, 3.0], BACK)
  np.testing.assert_allclose(volts, [0.5 * (0.6 + BACK), 3.0], atol=0.03)


@pytest.mark.parametrize(("weakness", "strength"), [(0.0, 1.0), (0.4, 0.6)])
def test_it_brakes_by_a_short_circuit_for_a_share_of_the_time(weakness, strength):
  """Half of the supply shorts the motor for half of the time: half of the back-EMF drives current."""
  volts = acting((0.0, 1.0, 0.0, weakness, 0.0), [-SUPPLY / 2, -SUPPLY], BACK)
  np.testing.assert_allclose(volts, BACK - BACK * strength * np.array([0.5, 1.0]), atol=0.02)


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_at_neutral_it_lets_go_or_drags(share):
  np.testing.assert_allclose(acting((0.0, 0.0, share, 0.0, 0.0), [0.0, 3.0], BACK), [share * BACK, 3.0], atol=0.03)


def test_it_brakes_to_standstill_and_drives_backwards_only_after_neutral():
  volts = acting(ALL, [3.0, -2.0, -2.0, -2.0, -2.0, 0.0, -2.0], [BACK, BACK, 0.05, 0.0, 0.0, 0.0, 0.0])
  assert 0.0 < volts[1] < BACK
  np.testing.assert_allclose(volts[3:], [0.0, 0.0, 0.0, -2.0], atol=1e-3)


@pytest.mark.parametrize("brake", [1.0, 0.0])
def test_without_reverse_a_command_backwards_brakes_whichever_way_the_car_rolls(brake):
  """Half of the supply shorts the motor for half of the time, and what stands still stays so."""
  never = (1.0, brake, 1.0, 0.0, 1.0)
  half = -SUPPLY / 2
  volts = acting(never, [0.0, half, half, half], [0.0, 0.0, -BACK, BACK])
  np.testing.assert_allclose(volts, [0.0, 0.0, -BACK / 2, BACK / 2], atol=0.02)


def test_forwards_it_drives_at_once():
  np.testing.assert_allclose(acting(ALL, [2.0, 2.0], [-BACK, 0.0], BRAKED), 2.0, atol=1e-3)


def test_a_car_that_stands_under_a_command_backwards_is_held_until_it_is_told_neutral():
  told = np.array([-2.0, -2.0, 0.0, 2.0])
  first = at_first(told, np.array([0.0, -BACK, 0.0, 0.0]), SUPPLY)
  assert first.tolist() == [ON_ITS_WAY, FREE, FREE, FREE]  # one that rolls backwards was driven backwards
  np.testing.assert_allclose(acting(ALL, [-2.0, -2.0, 0.0, -2.0], 0.0, ON_ITS_WAY), [0.0, 0.0, 0.0, -2.0], atol=1e-3)


def test_a_brake_that_holds_a_car_is_not_let_go_while_its_command_is_on_its_way():
  """A delay lets nothing through at first, which nobody told."""
  np.testing.assert_allclose(acting(ALL, [0.0, 0.0, -2.0, 0.0, -2.0], 0.0, ON_ITS_WAY), [0, 0, 0, 0, -2.0], atol=1e-3)


def driven(engine: str, commands: np.ndarray, sizes: dict[str, float], before: np.ndarray | None = None) -> np.ndarray:
  """Motor speeds, (T + 1,), of a car by duty, told so many volts."""
  twin = Twin(DUTY_CAR, select(["drive_delay", "drive_one_way"]), engine=engine)
  theta = np.array([twin.parameters.nominal])
  for name, size in sizes.items():
    theta[0, twin.parameters.index(name)] = size
  both = np.stack([commands / SUPPLY, np.zeros(len(commands))], axis=-1)[None]
  length = np.array([len(commands)])
  start = np.zeros((1, len(START)))
  segments = Segments(both, start, length, twin.period, ("drive",), np.zeros(1), before=before)
  return twin.rollout(theta, segments).signals[0, 0, :, 8]


COURSE = np.repeat([2.5, 0.0, 3.0, 1.0, -2.0, 0.0, -2.0, 0.0, 2.0], [60, 20, 40, 30, 60, 10, 50, 20, 40])


@pytest.mark.parametrize("delay", [0.0, 0.0137])
def test_both_engines_drive_alike(delay):
  exact, reduced = (driven(engine, COURSE, WHOLE | {"drive_delay": delay}) for engine in ("mujoco", "reduced"))
  assert np.ptp(exact) > 100.0  # rad/s: forwards, to a stop and backwards
  np.testing.assert_allclose(reduced, exact, atol=0.02 * np.abs(exact).max())


def test_a_car_without_reverse_drives_alike_in_both_engines_and_never_backwards():
  exact, reduced = (driven(engine, COURSE, FORWARDS) for engine in ("mujoco", "reduced"))
  np.testing.assert_allclose(reduced, exact, atol=0.02 * np.abs(exact).max())
  assert exact.max() > 100.0  # rad/s
  assert exact.min() > -1.0


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_diodes_let_a_motor_run_out_as_if_it_were_not_connected(engine):
  """What slows it down then is friction: half as much after twice the speed loss would be a motor that drags."""
  course = np.repeat([2.5, 0.0], [80, 40])
  free, drags = driven(engine, course, WHOLE), driven(engine, course, {})
  lost = lambda speed: speed[80] - speed[120]
  assert 0.0 < lost(free) < 0.5 * lost(drags)


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
@pytest.mark.parametrize("sizes", [{}, WHOLE], ids=["four quadrants", "one way"])
def test_a_delay_is_the_same_drive_later(engine, sizes):
  """Where it is whole periods; up to them nothing leaps, and between them speeds lie between."""
  course = np.repeat([0.0, 2.5, 0.0, 3.0], [5, 50, 20, 40])
  none, almost, one, more, two = (
    driven(engine, course, sizes | {"drive_delay": d}) for d in (0.0, 0.01 - 1e-9, 0.01, 0.013, 0.02)
  )
  np.testing.assert_allclose(one[1:], none[:-1], atol=1e-3)
  np.testing.assert_allclose(two[2:], none[:-2], atol=1e-3)
  np.testing.assert_allclose(almost, one, atol=1e-3)
  share = ((more - two) / np.where(np.abs(one - two) > 1.0, one - two, np.nan))[10:50]  # as it speeds up
  np.testing.assert_allclose(share, 0.7, atol=0.1)


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_what_it_was_told_before_the_log_began_tells_whether_the_brake_holds(engine):
  course = np.full(40, -2.0)
  told = lambda volts: np.array([[[volts / SUPPLY, 0.0]]])
  assert abs(driven(engine, course, WHOLE, told(-2.0))[-1]) < 0.5  # rad/s
  assert driven(engine, course, WHOLE, told(0.0))[-1] < -50.0
