"""The speed loop's integral part against the linear loop's own solution, at its limits, and where a stretch begins."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.plant import LEAD, SIGNALS, START, Segments
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR, Vehicle

CAR = Vehicle.from_dataset(
  {"name": "loop", "drive": "speed", "mass": 2.7, "cg_to_front": 0.125, "cg_to_rear": 0.131, "max_torque": 10.0}, {}
)
RATE, PERIOD = 4.0, 0.01
SPEED, MOTOR = SIGNALS.index("velocity_x"), SIGNALS.index("motor_speed")
TRAVEL = CAR.gear_ratio * CAR.wheel_radius


@pytest.fixture(params=["reduced", "mujoco"])
def twin(request) -> Twin:
  return Twin(CAR, select(["speed_loop_integral"]), substeps=2, threads=1, engine=request.param)


def values(twin: Twin, **given: float) -> np.ndarray:
  return twin.parameters.vector({"speed_loop_integral": RATE} | given)


def drive(command: np.ndarray, start: float = 0.0, lead: np.ndarray | None = None) -> Segments:
  """One stretch of a straight drive with commands (T,), from a speed, m/s."""
  commands = np.stack([command, 0.0 * command], axis=-1)[None]
  state = np.zeros((1, len(START)))
  state[0, START.index("velocity_x")] = start
  return Segments(commands, state, np.array([len(command)]), PERIOD, ("drive",), np.zeros(1), lead=lead)


def shown(twin: Twin, theta: np.ndarray, segments: Segments) -> np.ndarray:
  return twin.rollout(theta, segments).signals[0, 0]


def test_the_command_is_reached_in_spite_of_friction(twin):
  friction = {"driveline_friction": 5.0 * twin.base["driveline_friction"].nominal}
  command = np.full(400, 1.0)
  wanted = twin.base["torque_per_speed"].nominal / twin.base["motor_damping"].nominal
  with_it, without = (shown(twin, values(twin, speed_loop_integral=r, **friction), drive(command)) for r in (RATE, 0.0))
  assert with_it[-1, MOTOR] == pytest.approx(wanted, rel=0.002)
  assert without[-1, MOTOR] < 0.95 * wanted


def test_a_launch_is_the_linear_loops(twin):
  """w'' + (b / J) w' + (r b / J) w = (a / J) (u' + r u): a step's overshoot, without friction and far from limits."""
  theta = values(twin, driveline_friction=0.0, longitudinal_stiffness=twin.base["longitudinal_stiffness"].upper)
  base = twin.parameters.named(theta)
  car = dataclasses.replace(CAR, rotor_inertia=base["rotor_inertia"], wheel_inertia=base["wheel_inertia"])
  a, b = (base[name] / car.drive_inertia for name in ("torque_per_speed", "motor_damping"))
  command, fine = 0.5, 1e-4
  speed, memory, track = 0.0, 0.0, []
  for _ in range(round(1.5 / fine)):
    track.append(speed)
    missed = command - b / a * speed
    speed += fine * (a * (command + memory) - b * speed)
    memory += fine * RATE * missed
  exact = np.array(track)[:: round(PERIOD / fine)]
  driven = shown(twin, theta, drive(np.full(150, command)))[:-1, MOTOR]
  assert exact.max() > 1.05 * exact[-1]  # it does overshoot
  begun = 6  # periods, in which the driven wheels spin up on their tyres
  assert np.abs(driven - exact)[begun:].max() < 0.02 * exact[-1]


def test_at_the_limit_the_integral_gives_way_or_goes_on(twin):
  """A limit of a quarter of what the proportional part asks for: one that goes on adding overshoots far more."""
  limit = 0.25 * twin.base["torque_per_speed"].nominal
  peaks = [
    shown(twin, values(twin, max_torque=limit, speed_loop_giving_way=h), drive(np.full(300, 1.0)))[:, SPEED].max()
    for h in (1.0, 0.0)
  ]
  assert peaks[0] < 1.03 and peaks[1] > 1.08, peaks


def test_a_loop_that_forgets_at_rest_launches_alike_each_time(twin):
  command = np.concatenate([np.full(150, 1.0), np.zeros(150), np.full(150, 1.0)])
  theta = {"driveline_friction": 5.0 * twin.base["driveline_friction"].nominal}
  apart = []
  for q in (1.0, 0.0):
    speed = shown(twin, values(twin, speed_loop_forgetting=q, **theta), drive(command))[:, SPEED]
    apart.append(np.abs(speed[:80] - speed[300:380]).max())
  assert apart[0] < 0.02 < apart[1], apart


def test_a_loop_that_lets_go_rolls_out_where_it_is_told_to_stand_and_keeps_any_other_speed(twin):
  """As a driveline's friction slows it, T_c / J of all that moves; a loop that brakes stands within a second."""
  friction = twin.base["driveline_friction"].nominal
  command = np.concatenate([np.full(100, 1.0), np.zeros(100)])
  rolled, braked = (
    shown(twin, values(twin, speed_loop_release=y, driveline_friction=friction), drive(command, 1.0))
    for y in (1.0, 0.0)
  )
  np.testing.assert_allclose(rolled[:100, SPEED], braked[:100, SPEED], atol=2e-3)
  slowed = (rolled[110, MOTOR] - rolled[160, MOTOR]) / (50 * PERIOD)
  base = twin.parameters.named(values(twin))
  car = dataclasses.replace(CAR, rotor_inertia=base["rotor_inertia"], wheel_inertia=base["wheel_inertia"])
  assert slowed == pytest.approx(friction / car.drive_inertia, rel=0.1)
  assert braked[-1, SPEED] < 0.05 < 0.5 < rolled[110, SPEED]


def test_a_stretch_goes_on_with_what_the_loop_had_added_up(twin):
  """Begun in mid-launch from the drive before: nearer to the whole drive than a loop that begins empty."""
  command = np.full(200, 1.0)
  command[80:] = 1.6
  theta = values(twin, driveline_friction=5.0 * twin.base["driveline_friction"].nominal)
  whole = shown(twin, theta, drive(command))
  errors = []
  for at in (40, 90, 130):
    turned, when = whole[at - 20 : at, MOTOR], PERIOD * (np.arange(-20, 0))
    before = {
      "command": command[at - 20 : at].mean(), "motor_speed": turned.mean(),
      "motor_acceleration": np.polyfit(when, turned, 1)[0], "when": when.mean(),
    }  # fmt: skip
    start = float(whole[at, SPEED])
    for known in (np.array([[before[name] for name in LEAD]]), None):
      part = shown(twin, theta, drive(command[at:], start, known))
      errors.append(np.abs(part[: 200 - at, SPEED] - whole[at:200, SPEED]).max())
  assert all(led < 0.3 * empty and led < 0.03 for led, empty in zip(errors[::2], errors[1::2], strict=True)), errors


@pytest.mark.parametrize("rate", [0.0, RATE])
@pytest.mark.parametrize("engine", ["reduced", "mujoco"])
def test_a_loop_keeps_the_speed_that_its_encoder_shows(engine, rate):
  """Wheels 6 % larger than stated: the car is 6 % faster than one whose wheels are as stated, the encoder shows the
  same, and so does a stretch that begins under way at once."""
  car = Twin(CAR, select(["speed_loop_integral", "wheel_radius_error"]), substeps=2, threads=1, engine=engine)
  made = {"speed_loop_integral": rate, "driveline_friction": 5.0 * car.base["driveline_friction"].nominal}
  stated, larger = (car.parameters.vector(made | {"wheel_radius_error": e}) for e in (0.0, 0.06))
  command = np.full(400, 1.0)
  whole, other = (shown(car, theta, drive(command)) for theta in (stated, larger))
  assert other[-1, SPEED] == pytest.approx(1.06 * whole[-1, SPEED], rel=2e-3)
  assert other[-1, MOTOR] == pytest.approx(whole[-1, MOTOR], rel=2e-3)
  before = {"command": 1.0, "motor_speed": whole[-1, MOTOR], "motor_acceleration": 0.0, "when": -0.1}
  lead = np.array([[before[name] for name in LEAD]])
  part = shown(car, larger, drive(command[:50], float(whole[-1, MOTOR] * TRAVEL), lead))
  np.testing.assert_allclose(part[:50, SPEED], other[-1, SPEED], rtol=3e-3)


def test_only_a_car_that_is_commanded_a_speed_can_have_it():
  with pytest.raises(ValueError, match="drive by speed"):
    Twin(QCAR, select(["speed_loop_integral"]))


@pytest.mark.parametrize("delay", ["drive_delay", "command_delay"])
@pytest.mark.parametrize("release", [0.0, 1.0])
@pytest.mark.parametrize("engine", ["reduced", "mujoco"])
def test_every_part_of_a_delay_is_one_of_a_loop_at_its_limit(delay, release, engine):
  """A launch with all its torque, a roll-out, another launch: speeds of two delays differ by what the car gains in the
  time between, and in one step of the simulation. A mean of two commands pulled for whole periods, up to 11 cm/s, and a
  loop that lets go braked by how much slower the car had become since it was told."""
  limit, steps = 0.05, 5
  car = dataclasses.replace(CAR, max_torque=limit)
  twin = Twin(car, select(["speed_loop_integral", delay]), substeps=steps, threads=1, engine=engine)
  command = np.concatenate([np.zeros(30), np.full(80, 1.5), np.zeros(150), np.full(60, 0.6)])
  given = {"max_torque": limit, "speed_loop_release": release, "driveline_friction": 0.004}
  delays = np.array([0.002, 0.006, 0.0098, 0.0102, 0.014, 0.0198, 0.0202])
  speeds = np.stack([shown(twin, values(twin, **given | {delay: d}), drive(command))[:, SPEED] for d in delays])
  gained = np.abs(np.diff(speeds, axis=1)).max() / PERIOD
  apart = np.abs(np.diff(speeds, axis=0)).max(axis=1)
  assert (apart < 1.1 * gained * (np.diff(delays) + PERIOD / steps)).all(), apart
