"""The reduced car is MuJoCo's car, many times as fast: same structure, same mechanisms, nearly the same motion."""

import ctypes
import dataclasses
import sys

import numpy as np
import pytest

from qcar_twin.plant import SIGNALS, START, Segments
from qcar_twin.twin.engines.reduced import build, layout
from qcar_twin.twin.engines.reduced.cars import irreducible
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.reading import at_one_time
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

CAR = Vehicle.load()
ALL = [m for m in catalogue().values() if CAR.drive in m.drives]
PERIODS = 300
TIME = 0.01 * np.arange(PERIODS)
# share of the noise of usual sensors (accelerometer, gyro, encoder, motion capture): what a fit can see
NOISE = {"accel_x": 0.25, "accel_y": 0.25, "yaw_rate": 0.01, "motor_speed": 2.0, "pose_x": 0.005, "pose_y": 0.005}
MANOEUVRES = {
  "rest": (0.0 * TIME, 0.0 * TIME),
  "start": (np.where(TIME < 0.2, 0.0, 1.5), 0.0 * TIME),
  "coast": (np.where(TIME < 1.5, 1.5, 0.0), 0.0 * TIME),
  "brake gently": (np.where(TIME < 1.5, 1.5, 0.6), 0.0 * TIME),
  "reverse": (np.where(TIME < 0.2, 0.0, -1.0), 0.0 * TIME),
  "step steer": (1.2 + 0.0 * TIME, np.where(TIME < 1.0, 0.0, 0.15)),
  "circle": (1.0 + 0.0 * TIME, 0.25 + 0.0 * TIME),
  "tight circle": (0.8 + 0.0 * TIME, 0.4 * np.minimum(TIME / 0.5, 1.0)),
  "slalom": (1.2 + 0.0 * TIME, 0.15 * np.sin(2 * np.pi * 0.7 * TIME)),
  "quick slalom": (1.0 + 0.0 * TIME, 0.08 * np.sin(2 * np.pi * 2.0 * TIME)),
  "lock the wheels": (np.where(TIME < 1.0, 1.5, -1.5), 0.05 + 0.0 * TIME),
  "slide in a turn": (2.5 + 0.0 * TIME, np.where(TIME < 0.8, 0.0, 0.2)),
  "throttle in a turn": (1.0 + 0.4 * np.sign(np.sin(2 * np.pi * 0.5 * TIME)), 0.12 + 0.0 * TIME),
}


def stretches(manoeuvres=MANOEUVRES) -> Segments:
  commands = np.stack([np.stack(pair, axis=-1) for pair in manoeuvres.values()])
  size = len(commands)
  steps = np.full(size, PERIODS)
  return Segments(commands, np.zeros((size, len(START))), steps, 0.01, tuple(manoeuvres), np.zeros(size))


@pytest.fixture(scope="module")
def mujoco_car() -> Twin:
  return Twin(CAR, ALL, substeps=2, threads=1)


@pytest.fixture(scope="module")
def reduced(mujoco_car) -> Twin:
  return mujoco_car.on("reduced")


def with_effects(twin: Twin, names) -> np.ndarray:
  theta = twin.parameters.nominal
  for mechanism in twin.mechanisms:
    if mechanism.name in names:
      for p in mechanism.parameters:
        if p.null is not None:
          theta[twin.parameters.index(p.name)] = p.typical or p.scale
  return theta


@pytest.mark.parametrize("freedom", [0.0, 0.5, 1.0])
def test_manoeuvres_are_mujocos_within_a_share_of_sensor_noise(mujoco_car, reduced, freedom):
  theta, segments = mujoco_car.parameters.vector({"centre_differential": freedom}), stretches()
  wrong = reduced.rollout(theta, segments).signals[0] - mujoco_car.rollout(theta, segments).signals[0]
  within_noise(wrong)


@pytest.mark.parametrize(("lag", "inertia"), [(0.03, 0.5), (0.005, 0.3), (0.05, 0.1)])
def test_a_servo_of_second_order_moves_the_car_as_in_mujoco(mujoco_car, reduced, lag, inertia):
  theta = mujoco_car.parameters.vector({"servo_time_constant": lag, "servo_inertia": inertia})
  segments = stretches()
  wrong = reduced.rollout(theta, segments).signals[0] - mujoco_car.rollout(theta, segments).signals[0]
  within_noise(wrong)
  steering = SIGNALS.index("steering_angle")
  assert np.abs(wrong[..., steering]).max() < 2e-3


@pytest.mark.parametrize("inertia", [0.3, 3.0])  # of one wheel, of the nominal one
def test_dampers_between_wheels_stay_what_they_are_when_wheels_get_lighter(mujoco_car, reduced, inertia):
  """MuJoCo counts a damper in what its wheels weigh: taken from the nominal ones, a tight turn went 6 rad/s faster."""
  known = mujoco_car.parameters
  more = {"wheel_inertia": inertia * known["wheel_inertia"].nominal, "centre_differential": 0.07}
  more["differential_lock"] = known["differential_lock"].typical or known["differential_lock"].scale
  theta, segments = mujoco_car.parameters.vector(more), stretches()
  within_noise(reduced.rollout(theta, segments).signals[0] - mujoco_car.rollout(theta, segments).signals[0])


def test_every_parameter_of_the_base_moves_both_cars_alike(mujoco_car, reduced):
  """By its scale to either side, in every manoeuvre: a search on one car is confirmed by the other only then."""
  names, around = mujoco_car.base.names, {"centre_differential": 0.1}
  begun = mujoco_car.parameters.vector(around)
  columns = [begun]
  for name in names:
    parameter, i = mujoco_car.parameters[name], mujoco_car.parameters.index(name)
    for side in (-1.0, 1.0):
      columns.append(begun.copy())
      columns[-1][i] = np.clip(begun[i] + side * parameter.scale, parameter.lower, parameter.upper)
  theta, segments = np.stack(columns), stretches()
  wrong = reduced.rollout(theta, segments).signals - mujoco_car.rollout(theta, segments).signals
  for k, name in enumerate(np.repeat(names, 2), 1):
    for channel, noise in NOISE.items():
      apart = (wrong[k] - wrong[0])[..., SIGNALS.index(channel)]
      rms = np.sqrt(np.mean(apart**2, axis=1))
      assert rms.max() < noise, (name, channel, dict(zip(MANOEUVRES, rms, strict=True)))


def within_noise(wrong: np.ndarray) -> None:
  for name, noise in NOISE.items():
    rms = np.sqrt(np.mean(wrong[..., SIGNALS.index(name)] ** 2, axis=1))
    assert rms.max() < noise, (name, dict(zip(MANOEUVRES, rms, strict=True)))


@pytest.mark.parametrize("layout", ["rear", "front"])
def test_one_driven_axle_moves_the_car_as_in_mujoco(layout):
  """The wheels of the other axle roll each for itself: their speeds, and the spin they keep, are their own."""
  car = Twin(dataclasses.replace(CAR, layout=layout), substeps=2, threads=1)
  segments, theta = stretches(), car.parameters.nominal
  exact, reduced = (car.on(engine).rollout(theta, segments).signals[0] for engine in ("mujoco", "reduced"))
  within_noise(reduced - exact)
  both = Twin(CAR, substeps=2, threads=1, engine="reduced")
  driven = both.rollout(both.parameters.nominal, segments).signals[0]
  assert np.abs(reduced - driven)[..., SIGNALS.index("yaw_rate")].max() > 5 * NOISE["yaw_rate"]  # it matters


def columns(twin: Twin, segments: Segments, step: float) -> np.ndarray:
  """Slopes with respect to what every fit frees, in units of sensor noise per scale of the parameter, (p, values)."""
  base = twin.base
  moved = np.tile(twin.parameters.nominal, (2 * len(base), 1))
  rows = np.arange(len(base))
  moved[rows, rows] += step * base.scale
  moved[len(base) + rows, rows] -= step * base.scale
  signals = twin.rollout(moved, segments).signals
  scaled = np.stack([signals[..., SIGNALS.index(n)] / noise for n, noise in NOISE.items()], axis=-1)
  return (scaled[: len(base)] - scaled[len(base) :]).reshape(len(base), -1) / (2.0 * step)


def cosines(one: np.ndarray, other: np.ndarray) -> np.ndarray:
  norm = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
  return np.sum(one * other, axis=1) / np.maximum(norm, 1e-12)


def test_columns_point_where_mujocos_do(mujoco_car, reduced):
  segments = stretches()
  exact, own = (columns(twin, segments, 0.02) for twin in (mujoco_car, reduced))
  seen = np.linalg.norm(exact, axis=1) > 3.0  # what moves the signals by some of their noise within its own scale
  low = {n: c for n, c, s in zip(reduced.base.names, cosines(exact, own), seen, strict=True) if s and c < 0.97}
  assert seen.sum() > 12 and set(low) <= {"suspension_frequency"}, low


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_a_soft_tyres_swing_is_followed_to_second_order(engine):
  """Half the step leaves a quarter of yaw rate's error, backward Euler a half."""
  soft = dataclasses.replace(CAR, relaxation_length=0.08)
  start = np.zeros((1, len(START)))
  start[0, START.index("velocity_x")] = 0.8
  commands = np.tile([1.3, 0.1], (1, 100, 1))
  segments = Segments(commands, start, np.array([100]), 0.01, ("step",), np.zeros(1))
  turned = {}
  for substeps in (2, 4, 8, 64):
    twin = Twin(soft, substeps=substeps, threads=1, engine=engine)
    turned[substeps] = twin.rollout(twin.parameters.nominal, segments).signals[0, 0, :, SIGNALS.index("yaw_rate")]
  errors = [np.linalg.norm(turned[substeps] - turned[64]) for substeps in (2, 4, 8)]
  assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2]


def test_signals_have_no_jumps_where_wheels_slide(reduced):
  """A slope over a thousandth of a parameter's scale is that over a twentieth: nothing switches on the way."""
  segments = stretches({k: MANOEUVRES[k] for k in ("lock the wheels", "slide in a turn")})
  fine, coarse = (columns(reduced, segments, step) for step in (0.001, 0.05))
  seen = np.linalg.norm(coarse, axis=1) > 3.0
  low = {n: c for n, c, s in zip(reduced.base.names, cosines(fine, coarse), seen, strict=True) if s and c < 0.99}
  assert seen.sum() > 8 and not low, low


@pytest.mark.parametrize("name", sorted(m.name for m in ALL))
def test_every_mechanism_runs_and_null_is_absent_bit_for_bit(reduced, name):
  segments = stretches({k: MANOEUVRES[k] for k in ("slalom", "throttle in a turn")})
  bare = Twin(CAR, substeps=2, threads=1, engine="reduced")
  null = reduced.rollout(reduced.parameters.nominal, segments).signals[0]
  np.testing.assert_array_equal(bare.rollout(bare.parameters.nominal, segments).signals[0], null)
  present = reduced.rollout(with_effects(reduced, {name}), segments).signals[0]
  assert np.isfinite(present).all()


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_commands_worked_out_beforehand_are_those_of_every_period(engine):
  """What acts without asking how the car moves is run ahead of it; stepping asks it in every period."""
  names = {"steering_nonlinearity", "steering_lag", "drive_delay", "battery_discharge", "battery_sag", "stiction"}
  twin = Twin(CAR, [m for m in ALL if m.name in names], substeps=2, threads=1, engine=engine)
  segments = stretches({k: MANOEUVRES[k] for k in ("slalom", "coast")})
  for chosen in (names, names - {"battery_sag", "stiction"}):
    theta = np.tile(with_effects(twin, chosen), (2, 1))
    rollout = twin.rollout(theta[0], segments).signals[0]
    cars = twin.begin(theta, segments.start, first_command=segments.commands[:, 0])
    stepped = [cars.signals.copy()] + [cars.step(segments.commands[:, k]).copy() for k in range(PERIODS)]
    shown = at_one_time(np.stack(stepped, axis=1), twin.period / twin.substeps, twin.period)
    np.testing.assert_array_equal(shown, rollout)


def test_an_open_loop_mechanism_is_shown_no_signals(monkeypatch):
  """One that looks at the car all the same gets no number, so that the declaration can't be wrong unnoticed."""
  seen = []
  lag = catalogue()["steering_lag"]
  monkeypatch.setattr(
    type(lag), "command", lambda self, theta, context, state, command: seen.append(context) or command
  )
  twin = Twin(CAR, [lag], substeps=2, threads=1, engine="reduced")
  twin.rollout(with_effects(twin, {"steering_lag"}), stretches({"slalom": MANOEUVRES["slalom"]}))
  assert len(seen) == PERIODS and all(np.isnan(c.signals).all() and np.isnan(c.pose).all() for c in seen)


def test_a_car_does_not_depend_on_those_beside_it_nor_on_threads(reduced):
  segments = stretches()
  theta = np.stack(
    [with_effects(reduced, names) for names in ({"payload"}, {"battery_sag"}, set(), {"friction_patch"})]
  )
  theta[2, 0] *= 1.3
  together = reduced.rollout(theta, segments).signals
  threads = Twin(CAR, reduced.mechanisms, substeps=2, threads=2, engine="reduced").rollout(theta, segments).signals
  np.testing.assert_array_equal(threads, together)
  for k, row in enumerate(theta):
    np.testing.assert_array_equal(reduced.rollout(row, segments).signals[0], together[k])


def test_cars_that_are_not_running_stay(reduced):
  theta = np.tile(reduced.parameters.nominal, (6, 1))
  cars = reduced.begin(theta, np.zeros((6, len(START))))
  commands = np.tile([1.5, 0.1], (6, 1))
  for _ in range(20):
    cars.step(commands)
  before = cars.signals.copy()
  cars.step(commands, running=np.array([1, 4]))
  np.testing.assert_array_equal(cars.signals[[0, 2, 3, 5]], before[[0, 2, 3, 5]])
  assert (cars.signals[[1, 4], 0] > before[[1, 4], 0]).all()
  cars.step(commands)
  assert (cars.signals[:, 0] > before[:, 0]).all()


def test_mirrored_commands_give_mirrored_motion(reduced):
  mirror = {name: (drive, -steer) for name, (drive, steer) in MANOEUVRES.items()}
  theta = reduced.parameters.nominal
  one, other = (reduced.rollout(theta, stretches(m)).signals[0] for m in (MANOEUVRES, mirror))
  odd = [SIGNALS.index(n) for n in ("pose_y", "pose_yaw", "velocity_y", "yaw_rate", "accel_y", "steering_angle")]
  one[..., odd] *= -1.0
  np.testing.assert_allclose(one, other, atol=1e-6)


def test_a_coasting_car_only_loses_energy(reduced):
  start = np.zeros((1, len(START)))
  start[0, START.index("velocity_x")] = 1.5
  start[0, START.index("yaw_rate")] = 1.0
  cars = reduced.begin(reduced.parameters.nominal[None], start)
  energy = []
  for _ in range(600):
    s = cars.step(np.zeros((1, 2)))[0]
    energy.append(0.5 * CAR.mass * (s[3] ** 2 + s[4] ** 2) + 0.5 * CAR.yaw_inertia * s[5] ** 2)
  assert np.diff(energy[5:]).max() < 1e-4 and energy[-1] < 1e-3 * energy[0]


def test_a_car_that_is_none_gives_no_numbers_and_harms_no_other(reduced):
  segments = stretches({"slalom": MANOEUVRES["slalom"]})
  theta = np.tile(reduced.parameters.nominal, (3, 1))
  theta[1, reduced.parameters.index("payload_mass")] = -CAR.mass
  with np.errstate(all="ignore"):
    ends = reduced.rollout(theta, segments).signals[:, 0]
  assert np.isnan(ends[1]).any() and not np.any(np.abs(ends[1]) > 1e6)
  np.testing.assert_array_equal(ends[0], reduced.rollout(theta[0], segments).signals[0, 0])
  np.testing.assert_array_equal(ends[0], ends[2])


def test_what_it_lacks_it_says():
  other = dataclasses.replace(CAR, rolling_resistance=0.01)
  assert irreducible(CAR, "contact") == ""
  assert irreducible(other, "native").startswith("it lacks MuJoCo's own friction and rolling resistance")
  with pytest.raises(ValueError, match='by the reduced car: it lacks rolling resistance.*use engine="mujoco"'):
    Twin(dataclasses.replace(CAR, rolling_resistance=0.01), engine="reduced")
  with pytest.raises(ValueError, match="engine must be one of mujoco, reduced, not 'bullet'"):
    Twin(CAR, engine="bullet")  # type: ignore[arg-type]


def test_every_compiler_and_processor_gives_the_same_bits(tmp_path, rows):
  """The tuned build, the plain one and the wheel's compiler: a period of the same cars."""
  rng, size, ends = np.random.default_rng(3), 8, []
  numbers = rows["numbers"] * (1.0 + 0.01 * rng.standard_normal((layout.N_NUMBER, size)))
  for k, (compiler, tuning) in enumerate(
    [
      (build.compilers()[0], build.TUNED),
      (build.compilers()[0], build.PLAIN),
      ([sys.executable, "-m", "ziglang", "cc"], build.PLAIN),
    ]
  ):
    target = tmp_path / f"{k}.so"
    build.compile_car(compiler, tuning, target)
    library = ctypes.CDLL(str(target))
    library.advance.argtypes = build.load().advance.argtypes
    library.advance.restype = None
    state = rows["state"].repeat(size, axis=1).copy()
    library.lanes.restype = ctypes.c_long
    signals, blocks = np.zeros((size, len(SIGNALS))), np.arange(size // library.lanes())
    commands = np.tile([1.5, 0.2], (size, 1))
    pointers = [a.ctypes.data for a in (rows["constants"], numbers, state)]
    for _ in range(50):
      library.advance(
        *pointers, size, size, commands.ctypes.data, None, signals.ctypes.data, 2, blocks.ctypes.data, len(blocks)
      )
    ends.append(state.tobytes() + signals.tobytes())
  assert np.isfinite(signals).all() and signals[0, 0] > 0.1
  assert ends[0] == ends[1] == ends[2]


@pytest.fixture(scope="module")
def rows() -> dict[str, np.ndarray]:
  """Numbers, constants and state of a nominal car, as the engine writes them."""
  twin = Twin(CAR, substeps=2, threads=1, engine="reduced")
  engine = twin.begin(twin.parameters.nominal[None], np.zeros((1, len(START)))).engine
  return {"numbers": engine.numbers[:, :1], "constants": engine.constants, "state": engine.state[:, :1]}
