"""The whole catalogue in the MuJoCo twin: absence, mirrors, energy, bounds, and sizes found again."""

import numpy as np
import pytest

from qcar_twin.plant import SIGNALS, START, Segments
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

ALL = [m for m in catalogue().values() if "voltage" in m.drives]
STEPPED = [m for m in ALL if m.stage != "sensor"]
each = pytest.mark.parametrize("mechanism", ALL, ids=lambda m: m.name)
PERIOD, STEPS = 0.01, 200
MIRRORED = ("pose_y", "pose_yaw", "velocity_y", "yaw_rate", "accel_y", "steering_angle")
# nothing to fit smoothly: a servo that holds jumps from sample to sample, so its fit gets a wider goal
LOOSE = {"steering_quantisation": 0.2, "steering_backlash": 0.05, "driveline_backlash": 0.05}


def segments(mirrored: bool = False) -> Segments:
  """Two drives of 2 s: voltage flips with a steering chirp, and a turn at speed that ends in coasting."""
  time = np.arange(STEPS) * PERIOD
  chirp = 0.28 * np.sin(2 * np.pi * (0.5 + 0.6 * time) * time)
  flips = 1.4 + 0.9 * np.sign(np.sin(2 * np.pi * 0.9 * time)) * (time > 0.25) - 2.6 * (time > 1.7)
  turn = np.where(time < 0.5, 0.0, np.where(time < 1.2, 0.3, -0.15))
  coast = np.where(time < 1.1, 2.2, 0.0)
  commands = np.stack([np.stack([flips, chirp], -1), np.stack([coast, turn], -1)])
  start = np.zeros((2, len(START)))
  start[1, 3] = 1.0
  side = [1.0, -1.0] if mirrored else [1.0, 1.0]
  history = np.array([[100.0, 400.0], [150.0, 600.0]])
  return Segments(commands * side, start, np.full(2, STEPS), PERIOD, ("a", "b"), np.zeros(2), history=history)


@pytest.fixture(scope="module")
def twin() -> Twin:
  return Twin(Vehicle.load(), ALL, threads=1)


def sized(twin: Twin, mechanism, share: float) -> np.ndarray:
  """A parameter vector with every amplitude of one mechanism at `share` of its typical size, all others absent."""
  values = {p.name: np.clip(share * p.typical, p.lower, p.upper) for p in mechanism.parameters if p.null is not None}
  if mechanism.name == "friction_patch":
    values["friction_patch_y"] = 0.3  # to the left of where the drives begin
  return twin.parameters.vector(values)


@pytest.fixture(scope="module")
def nominal(twin):
  return twin.rollout(twin.parameters.nominal, segments()).signals[0]


@pytest.fixture(scope="module")
def typical(twin):
  """Name -> signals (2, T + 1, 10) with that mechanism at its typical size; one rollout for all."""
  theta = np.stack([sized(twin, m, 1.0) for m in ALL])
  return dict(zip((m.name for m in ALL), twin.rollout(theta, segments()).signals, strict=True))


def distance(signals, other) -> np.ndarray:
  """RMS difference per signal over the other's RMS, (10,)."""
  axes = tuple(range(signals.ndim - 1))
  return np.sqrt(np.mean((signals - other) ** 2, axes)) / np.sqrt(np.mean(other**2, axes) + 1e-12)


def test_a_full_catalogue_at_null_is_the_bare_twin_bit_for_bit(nominal):
  bare = Twin(Vehicle.load(), (), threads=1)
  np.testing.assert_array_equal(bare.rollout(bare.parameters.nominal, segments()).signals[0], nominal)


def test_cars_without_a_mechanism_do_not_feel_their_neighbours(twin, nominal):
  theta = np.stack([twin.parameters.nominal, *(sized(twin, m, 1.0) for m in STEPPED[::3]), twin.parameters.nominal])
  signals = twin.rollout(theta, segments()).signals
  np.testing.assert_array_equal(signals[0], nominal)
  np.testing.assert_array_equal(signals[-1], nominal)


@each
def test_mechanism_alone_equals_mechanism_in_the_crowd(twin, typical, mechanism):
  alone = twin.rollout(sized(twin, mechanism, 1.0), segments()).signals[0]
  np.testing.assert_array_equal(alone, typical[mechanism.name])


@each
def test_typical_size_is_seen(typical, nominal, mechanism):
  moved = distance(typical[mechanism.name], nominal)
  assert np.all(np.isfinite(typical[mechanism.name]))
  assert moved.max() > 0.005, dict(zip(SIGNALS, moved.round(4), strict=True))


def test_mirrored_commands_give_mirrored_motion_unless_declared(twin, typical):
  sign = np.array([-1.0 if s in MIRRORED else 1.0 for s in SIGNALS])
  theta = np.stack([twin.parameters.nominal, *(sized(twin, m, 1.0) for m in ALL)])
  mirrored = twin.rollout(theta, segments(mirrored=True)).signals * sign
  floor = distance(mirrored[0], twin.rollout(theta[:1], segments()).signals[0])[:6].max()
  assert floor < 1e-5
  for mechanism, other in zip(ALL, mirrored[1:], strict=True):
    far = distance(other, typical[mechanism.name])[[0, 1, 2, 3, 4, 5, 6, 7]].max()
    if mechanism.symmetric:
      assert far < 1e-3, mechanism.name
    else:
      assert far > 1e-3 + 100 * floor, mechanism.name


def test_dissipative_ones_leave_less_energy_in_a_coasting_car(twin):
  """Straight and turning coast-downs, no voltage: speed is never above that of the bare car.

  But for some mm/s of pitching as the car stops, which each does at its own time.
  """
  names = [m for m in STEPPED if m.dissipative]
  theta = np.stack([twin.parameters.nominal, *(sized(twin, m, 1.0) for m in names)])
  commands = np.zeros((2, 100, 2))
  commands[1, :, 1] = 0.3
  start = np.zeros((2, len(START)))
  start[:, 3] = 1.2
  start[1, 6] = 0.3
  coasting = Segments(commands, start, np.full(2, 100), PERIOD, ("a", "b"), np.zeros(2))
  speed = twin.rollout(theta, coasting).channel("velocity_x")
  for mechanism, rows in zip(names, speed[1:], strict=True):
    assert np.all(rows <= speed[0] + 6e-3), mechanism.name
    assert np.any(rows < speed[0] - 5e-3), mechanism.name


@pytest.mark.parametrize("share", [3.0, -3.0])
def test_three_times_typical_is_stable(twin, share):
  signals = twin.rollout(np.stack([sized(twin, m, share) for m in STEPPED]), segments()).signals
  assert np.all(np.isfinite(signals))
  for mechanism, track in zip(STEPPED, signals, strict=True):
    assert np.max(np.abs(track[..., 3])) < 6.0, mechanism.name
    # a hold-and-push instability shows as accelerations that alternate from period to period
    jitter = np.diff(track[:, 20:, 5], n=2, axis=1)
    assert np.sqrt(np.mean(jitter**2)) < 0.25, mechanism.name


def test_at_rest_nothing_moves(twin):
  """Without commands a car stands still under everything but a slope, a payload's settling and cogging."""
  stand = Segments(np.zeros((1, 100, 2)), np.zeros((1, 7)), np.full(1, 100), PERIOD, ("a",), np.zeros(1))
  theta = np.stack([sized(twin, m, 1.0) for m in STEPPED])
  signals = twin.rollout(theta, stand).signals[:, 0]
  for mechanism, track in zip(STEPPED, signals, strict=True):
    goal = 0.05 if mechanism.name in ("floor_slope", "payload", "cogging") else 2e-3
    assert np.max(np.abs(track[:, :3])) < goal, mechanism.name


def whitened(signals, nominal, scale):
  return ((signals - nominal) / scale)[:, 1:].reshape(-1)


def test_own_sizes_are_found_again(twin, nominal):
  """Gauss-Newton for all mechanisms side by side: data at 0.8 typical, start at the best of three sizes."""
  scale = np.sqrt(np.mean(nominal**2, axis=(0, 1))) + 1e-6
  data = twin.rollout(np.stack([sized(twin, m, 0.8) for m in ALL]), segments()).signals
  theta = _best_of(twin, (0.25, 0.6, 1.6), data, scale)
  columns = [[twin.parameters.index(p.name) for p in m.parameters if p.null is not None] for m in ALL]
  truth = [0.8 * twin.parameters.scale[cs] for cs in columns]
  moving = list(range(len(ALL)))
  for _ in range(15):
    moving = moving and _gauss_newton(twin, theta, columns, data / scale, scale, moving)
  for mechanism, row, cs, true in zip(ALL, theta, columns, truth, strict=True):
    if mechanism.curve:  # two voltages do not show the heights between them
      continue
    np.testing.assert_allclose(row[cs], true, rtol=LOOSE.get(mechanism.name, 0.02), err_msg=mechanism.name)


def _best_of(twin, shares, data, scale) -> np.ndarray:
  """For every mechanism the size, of some, whose signals are nearest to its data."""
  theta = np.stack([sized(twin, m, share) for share in shares for m in ALL])
  signals = twin.rollout(theta, segments()).signals.reshape(len(shares), *data.shape)
  error = np.sum(((signals - data) / scale) ** 2, axis=(2, 3, 4))
  return theta.reshape(len(shares), len(ALL), -1)[np.argmin(error, axis=0), np.arange(len(ALL))]


def _gauss_newton(twin, theta, columns, data, scale, moving) -> list[int]:
  """One step of the rows `moving` of theta, their finite differences in one rollout; those not settled yet."""
  unit, parameters = twin.parameters.scale, twin.parameters
  rows = [theta[i] for i in moving]
  for i in moving:
    for c in columns[i]:
      rows.append(theta[i] + 1e-2 * unit * (np.arange(len(unit)) == c))
  tracks = iter(twin.rollout(np.stack(rows), segments()).signals / scale)
  here, unsettled = {i: next(tracks) for i in moving}, []
  for i in moving:
    slopes = np.stack([(next(tracks) - here[i]).ravel() / 1e-2 for _ in columns[i]], axis=-1)
    step = np.clip(np.linalg.lstsq(slopes, (data[i] - here[i]).ravel(), rcond=None)[0], -0.6, 0.6)
    cs = columns[i]
    theta[i, cs] = np.clip(theta[i, cs] + step * unit[cs], parameters.lower[cs], parameters.upper[cs])
    unsettled += [i] if np.any(np.abs(step) > 2e-3) else []
  return unsettled


def test_sets_of_three_work_together(twin):
  """Random triples at typical size: finite, and each differs from what any two of them give."""
  rng = np.random.default_rng(8)
  triples = [rng.choice(len(STEPPED), 3, replace=False) for _ in range(12)]
  nulls = twin.parameters.nominal

  def together(members):
    return nulls + sum(sized(twin, STEPPED[i], 1.0) - nulls for i in members)

  theta = [together(t[list(keep)]) for t in triples for keep in ((0, 1, 2), (0, 1), (0, 2), (1, 2))]
  signals = twin.rollout(np.stack(theta), segments()).signals.reshape(12, 4, 2, STEPS + 1, len(SIGNALS))
  assert np.all(np.isfinite(signals))
  for triple, (whole, *pairs) in zip(triples, signals, strict=True):
    names = [STEPPED[i].name for i in triple]
    assert all(distance(pair, whole).max() > 1e-3 for pair in pairs), names


def test_mechanisms_act_along_the_signal_chain_whatever_order_they_are_given_in(twin):
  other = Twin(Vehicle.load(), ALL[::-1], threads=1)
  names = ("imu_lever_arm_x", "gyro_scale", "accel_bias_x", "imu_latency", "steering_play", "steering_delay")
  values = dict(zip(names, (0.1, 0.1, 0.3, 0.02, 0.03, 0.04), strict=True))
  here, there = (t.rollout(t.parameters.vector(values)[None], segments()).signals for t in (twin, other))
  assert here == pytest.approx(there, abs=1e-12)


def test_a_lever_arm_feels_the_rotation_and_not_what_the_gyro_says_of_it(twin):
  signals = np.zeros((1, 5, len(SIGNALS)))
  signals[..., SIGNALS.index("yaw_rate")] = 2.0
  theta = twin.parameters.vector({"imu_lever_arm_x": 0.1, "gyro_scale": 0.1, "gyro_bias": 0.05})[None]
  shown = twin.sensed(theta, signals.copy(), np.zeros(1))
  assert shown[..., SIGNALS.index("accel_x")] == pytest.approx(-0.1 * 2.0**2)
  assert shown[..., SIGNALS.index("yaw_rate")] == pytest.approx(1.1 * 2.0 + 0.05)
