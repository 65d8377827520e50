"""The twin: reductions to exact things, and independence of how simulations are grouped."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.plant import SIGNALS, START, Segments
from qcar_twin.twin.file import load_twin, save_twin
from qcar_twin.twin.mechanisms import catalogue, select
from qcar_twin.twin.parameters import base_parameters
from qcar_twin.twin.reading import at_one_time
from qcar_twin.twin.simulation import mujoco_batch
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

CAR = Vehicle.load()


def drive(voltage=1.5, steering=(0.15, -0.2, 0.0), seconds=1.5) -> Segments:
  """One segment per steering angle; the steering comes after half the time."""
  steps = int(seconds * 100)
  commands = np.zeros((len(steering), steps, 2))
  commands[:, :, 0] = voltage
  commands[:, steps // 2 :, 1] = np.asarray(steering)[:, None]
  count = len(steering)
  names = tuple(f"drive {i}" for i in range(count))
  return Segments(commands, np.zeros((count, len(START))), np.full(count, steps), 0.01, names, np.zeros(count))


@pytest.fixture(scope="module")
def twin() -> Twin:
  return Twin(CAR, substeps=2)


def test_any_grouping_gives_the_same_bits(twin: Twin):
  segments = drive()
  theta = np.stack([twin.parameters.nominal, twin.parameters.vector({"mass": 3.0, "cornering_stiffness_front": 150.0})])
  together = twin.rollout(theta, segments).signals
  one_by_one = np.concatenate([twin.rollout(t, segments).signals for t in theta])
  narrow = Twin(CAR, substeps=2, threads=1, rows=3).rollout(theta, segments).signals
  np.testing.assert_array_equal(together, one_by_one)
  np.testing.assert_array_equal(together, narrow)


def test_a_stretch_shorter_than_its_padding_is_driven_to_its_end_and_no_further(twin: Twin):
  """And a quarter of a second beyond it, for sensors with fast clocks."""
  whole = twin.rollout(twin.parameters.nominal, drive()).signals[0]
  steps = np.array([150, 60, 30])
  cut = twin.rollout(twin.parameters.nominal, dataclasses.replace(drive(), steps=steps)).signals[0]
  for before, after, end in zip(whole, cut, np.minimum(steps + 25, 150), strict=True):
    np.testing.assert_array_equal(after[:end], before[:end])  # the last has no reading after it
    assert np.all(after[end:] == after[end])
  short = twin.rollout(twin.parameters.nominal, dataclasses.replace(drive(), steps=np.array([10, 5, 5]))).signals[0]
  np.testing.assert_array_equal(short[0, :35], whole[0, :35])
  assert np.all(short[0, 35:] == short[0, 35])


def test_stepping_equals_a_rollout(twin: Twin):
  segments = drive()
  rollout = twin.rollout(twin.parameters.nominal, segments).signals[0]
  simulation = twin.begin(np.tile(twin.parameters.nominal, (3, 1)), segments.start)
  stepped = [simulation.signals.copy()] + [simulation.step(segments.commands[:, k]).copy() for k in range(150)]
  shown = at_one_time(np.stack(stepped, axis=1), twin.period / twin.substeps, twin.period)
  np.testing.assert_array_equal(shown, rollout)


def test_the_imu_stays_where_it_was_stated_from_the_centre_of_gravity(twin: Twin):
  """A centre of gravity found 10 mm further back has the IMU there, too: a turn at rate r does not show -r^2 10 mm."""
  theta = np.stack([twin.parameters.nominal, twin.parameters.vector({"cg_to_front": CAR.cg_to_front + 0.01})])
  simulation = twin.begin(theta, np.zeros((2, len(START))))
  imu = twin.model.site("imu").id
  place = mujoco_batch(simulation).expand("site_pos")[:, imu, 0]
  np.testing.assert_allclose(place, [CAR.imu_x, CAR.imu_x - 0.01], atol=1e-12)


def test_simulations_of_one_twin_do_not_disturb_each_other(twin: Twin):
  theta, start = twin.parameters.nominal[None], np.zeros((1, len(START)))
  one, other = twin.begin(theta, start), twin.begin(theta, start)
  alone = twin.begin(theta, start)
  for _ in range(30):
    one.step(np.array([[2.0, 0.1]]))
    other.step(np.array([[-1.0, 0.0]]))
  for _ in range(30):
    alone.step(np.array([[2.0, 0.1]]))
  np.testing.assert_array_equal(one.signals, alone.signals)


def test_segments_tell_when_and_where_they_were_driven():
  pose = np.full((2, 6, 3), np.nan)
  pose[1, :3] = [[1.0, 2.0, 0.1], [1.1, 2.0, 0.1], [1.2, np.nan, 0.1]]
  history = np.array([[40.0, 9.0], [12.0, 3.0]])
  start, commands = np.zeros((2, len(START))), np.zeros((2, 5, 2))
  plain = Segments(commands, start, np.array([5, 3]), 0.1, ("a", "b"), np.zeros(2))
  assert (plain.driving.first, plain.driving.last, len(plain.driving.places)) == (0.0, 0.5, 0)
  known = dataclasses.replace(plain, history=history, pose=pose).driving
  assert (known.first, known.last) == (12.0, 40.5)
  np.testing.assert_array_equal(known.places, [[1.0, 2.0], [1.1, 2.0]])


def test_mirrored_commands_give_mirrored_motion(twin: Twin):
  signals = twin.rollout(twin.parameters.nominal, drive(steering=(0.2, -0.2))).signals[0]
  odd = np.array(
    [name in ("pose_y", "pose_yaw", "velocity_y", "yaw_rate", "accel_y", "steering_angle") for name in SIGNALS]
  )
  np.testing.assert_allclose(signals[0], signals[1] * np.where(odd, -1.0, 1.0), atol=2e-3)


def test_nothing_moves_without_a_command(twin: Twin):
  signals = twin.rollout(twin.parameters.nominal, drive(voltage=0.0, steering=(0.0,), seconds=1.0)).signals[0, 0]
  assert np.abs(signals[:, 3:6]).max() < 1e-6


def test_steady_speed_balances_torque_damping_and_friction(twin: Twin):
  values = twin.parameters.named(twin.parameters.nominal)
  end = twin.rollout(twin.parameters.nominal, drive(voltage=2.0, steering=(0.0,), seconds=6.0)).channel("motor_speed")[
    0, 0, -1
  ]
  expected = (values["torque_per_volt"] * 2.0 - values["driveline_friction"]) / values["motor_damping"]
  assert end == pytest.approx(expected, rel=0.01)


def test_a_steady_turn_has_the_single_track_yaw_rate(twin: Twin):
  # neutral steer: yaw rate = v delta / L at small angles; Ackermann steering off, so that both wheels are at delta
  theta = twin.parameters.vector({"ackermann_fraction": 0.0})
  signals = twin.rollout(theta, drive(voltage=1.0, steering=(0.05,), seconds=6.0)).signals[0, 0, -1]
  v, r = signals[SIGNALS.index("velocity_x")], signals[SIGNALS.index("yaw_rate")]
  assert r == pytest.approx(v * 0.05 / CAR.wheelbase, rel=0.02)


@pytest.mark.parametrize("frequency", [4.0, 16.0])
def test_a_fitted_suspension_is_the_car_built_with_it(twin: Twin, frequency):
  """Bounce frequency as a parameter equals the compiled model's; a softer car feels more of g sin(roll)."""
  built = Twin(dataclasses.replace(CAR, suspension_frequency=frequency), substeps=2)
  wanted = built.rollout(built.parameters.nominal, drive()).signals
  fitted = twin.rollout(twin.parameters.vector({"suspension_frequency": frequency}), drive()).signals
  np.testing.assert_allclose(fitted, wanted, atol=1e-9)


def test_a_stated_bounce_is_as_sure_as_its_owner_says():
  stated = dataclasses.replace(CAR, suspension_frequency=4.6, std={"suspension_frequency": 0.2})
  told, guessed = (base_parameters(car)["suspension_frequency"] for car in (stated, CAR))
  assert (told.nominal, told.std, told.assumed) == (4.6, 0.2, False)
  assert (guessed.std, guessed.assumed) == (0.5 * CAR.suspension_frequency, True)


def test_a_softer_car_feels_more_of_its_roll(twin: Twin):
  """accel_y / (v_x r) - 1 = g h / ((pi f t)^2 - g h) and what wheel contacts give, about a hundredth."""
  theta = np.stack([twin.parameters.vector({"suspension_frequency": f}) for f in (4.0, 8.0)])
  signals = twin.rollout(theta, drive(steering=(0.15,))).signals[:, 0, -1]
  accel, speed, yaw_rate = (signals[:, SIGNALS.index(name)] for name in ("accel_y", "velocity_x", "yaw_rate"))
  lever = 9.81 * CAR.cg_height
  expected = lever / ((np.pi * np.array([4.0, 8.0]) * CAR.track_width) ** 2 - lever)
  np.testing.assert_allclose(accel / (speed * yaw_rate) - 1.0, expected + 0.01, rtol=0.2)


@pytest.mark.parametrize("name", ["suspension_frequency", "rotor_inertia"])
@pytest.mark.parametrize("at", ["lower", "upper"])
def test_a_fit_may_go_to_its_bounds(name, at):
  """Driving, braking and turning on steps of 5 ms: stiff springs and light rotors stay stable."""
  car = dataclasses.replace(CAR, mass=2.4, wheel_mass=0.065)
  twin = Twin(car, substeps=2)
  commands = np.zeros((1, 400, 2))
  commands[0, :, 0] = 2.5 * np.sign(np.sin(2 * np.pi * 0.8 * np.arange(400) * 0.01))
  commands[0, 200:, 1] = 0.3
  driving = Segments(commands, np.zeros((1, len(START))), np.full(1, 400), 0.01, ("drive",), np.zeros(1))
  worst = {"suspension_frequency": twin.parameters["suspension_frequency"].upper, "rotor_inertia": 5e-7}
  theta = twin.parameters.vector(worst | {name: getattr(twin.parameters[name], at)})
  signals = twin.rollout(theta, driving).signals[0, 0]
  assert np.abs(signals[:, SIGNALS.index("accel_x")]).max() < 40.0
  assert np.abs(signals[:, SIGNALS.index("yaw_rate")]).max() < 6.0


def test_the_step_hardly_matters():
  segments = drive()
  coarse, fine = (Twin(CAR, substeps=n).rollout(Twin(CAR).parameters.nominal, segments) for n in (2, 10))
  for name, scale in (("velocity_x", 1.0), ("yaw_rate", 1.0)):
    error = np.sqrt(np.mean((coarse.channel(name) - fine.channel(name)) ** 2))
    assert error < 0.01 * scale, name


def test_a_mechanism_at_its_null_is_absent_bit_for_bit(twin: Twin):
  loaded = twin.with_mechanisms(tuple(m for m in catalogue().values() if CAR.drive in m.drives))
  np.testing.assert_array_equal(
    loaded.rollout(loaded.parameters.nominal, drive()).signals, twin.rollout(twin.parameters.nominal, drive()).signals
  )


@pytest.fixture(scope="module")
def ripple():
  """A twin that cogs, its parameters, 2 s of driving, the signals and the wheels' angle it had, (1, T + 1)."""
  cogging = Twin(CAR, select(["cogging"]), substeps=2)
  theta = cogging.parameters.vector({"cogging": 0.2, "cogging_cosine": 0.1, "cogging_order": 5.0})
  driving = drive(steering=(0.0,), seconds=2.0)
  rolled = cogging.rollout(theta, driving)
  turns = 0.01 * CAR.gear_ratio * np.cumsum(rolled.channel("motor_speed")[0], axis=1)
  return cogging, theta, driving, rolled.signals[0], np.pad(turns, ((0, 0), (1, 0)))[:, :-1]


def test_a_ripple_keeps_its_phase_from_segment_to_segment(ripple):
  """The second half by itself, with an encoder's angle, is the second half of the whole; without it, it is not."""
  cogging, theta, driving, whole, angle = ripple
  start = whole[:, 100, [SIGNALS.index(name) for name in START]]
  half = dataclasses.replace(driving, commands=driving.commands[:, 100:], steps=np.array([100]), start=start)
  known = dataclasses.replace(half, wheel_angle=angle[:, 100:])
  speed = SIGNALS.index("motor_speed")
  far = [np.std((cogging.rollout(theta, s).signals[0] - whole[:, 100:])[0, 20:, speed]) for s in (known, half)]
  assert far[0] < 0.05 * far[1]


def test_a_ripple_without_an_encoder_goes_with_the_simulated_wheels(ripple):
  cogging, theta, driving, whole, angle = ripple
  for known in (np.full_like(angle, np.nan), np.where(np.arange(201) < 50, angle, np.nan), angle):
    again = cogging.rollout(theta, dataclasses.replace(driving, wheel_angle=known)).signals[0]
    np.testing.assert_allclose(again, whole, rtol=1e-9, atol=1e-9)


def test_an_absent_ripple_leaves_the_measured_angle_unread(ripple):
  cogging, _, driving, _, angle = ripple
  known = dataclasses.replace(driving, wheel_angle=angle + 1.0)
  bare = Twin(CAR, substeps=2)
  expected = bare.rollout(bare.parameters.nominal, driving).signals
  np.testing.assert_array_equal(cogging.rollout(cogging.parameters.nominal, known).signals, expected)


def test_sensor_mechanisms_share_one_simulation(twin: Twin, monkeypatch):
  loaded = twin.with_mechanisms(select(["gyro_scale"]))
  theta = np.tile(loaded.parameters.nominal, (3, 1))
  theta[:, loaded.parameters.index("gyro_scale")] = [0.0, 0.1, -0.1]
  simulated = []
  original = Twin.simulate
  monkeypatch.setattr(Twin, "simulate", lambda self, t, s: simulated.append(len(t)) or original(self, t, s))
  rates = loaded.rollout(theta, drive()).channel("yaw_rate")
  assert simulated == [1]
  np.testing.assert_allclose(rates[1], 1.1 * rates[0], rtol=1e-12)
  np.testing.assert_allclose(rates[2], 0.9 * rates[0], rtol=1e-12)


def test_a_wrong_shape_of_parameters_is_refused(twin: Twin):
  with pytest.raises(ValueError, match="theta must be \\(2, "):
    twin.begin(np.zeros((1, 3)), np.zeros((2, 7)))


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_what_is_no_command_and_no_car_is_refused(twin: Twin, engine):
  twin, theta = twin.on(engine), twin.parameters.nominal
  car = twin.begin(theta, np.zeros((1, 7)))
  for commands in ([[np.nan, 0.0]], [[1.0, np.inf]]):
    with pytest.raises(ValueError, match="of car 0: give finite numbers"):
      car.step(np.array(commands))
  with pytest.raises(ValueError, match=r"commands must be \(1, 2\)"):
    car.step(np.array([1.0, 0.0]))
  with pytest.raises(ValueError, match="theta and start must be finite"):
    twin.begin(np.where(np.arange(len(theta)) == 0, np.nan, theta), np.zeros((1, 7)))


def test_a_printed_twin_names_its_parts(twin: Twin):
  text = repr(twin.with_mechanisms(select(["steering_delay"])))
  assert "base: mass = 2.7 kg" in text
  assert "command: steering_delay (steering_delay [s])" in text


def test_a_file_gives_the_same_twin_back(tmp_path):
  twin = Twin(dataclasses.replace(CAR, name='Auto "Ü"'), select(["steering_delay", "gyro_scale"]), substeps=2)
  theta = twin.parameters.vector({"mass": 2.9, "steering_delay": 0.03})
  again, loaded = load_twin(save_twin(tmp_path / "twin.toml", twin, theta), substeps=2)
  assert [m.name for m in again.mechanisms] == ["steering_delay"]  # a null mechanism is left out
  assert again.vehicle == twin.vehicle
  np.testing.assert_array_equal(again.rollout(loaded, drive()).signals, twin.rollout(theta, drive()).signals)


def test_a_bad_twin_file_says_what_to_do(tmp_path):
  with pytest.raises(FileNotFoundError, match="nothing.toml: no such twin file; calibrate first"):
    load_twin(tmp_path / "nothing.toml")
  (tmp_path / "bad.toml").write_text("format = 7")
  with pytest.raises(ValueError, match="bad.toml: not a twin file of format 1"):
    load_twin(tmp_path / "bad.toml")
  (tmp_path / "drive.csv").write_text("time,speed\n0,1\n")
  with pytest.raises(ValueError, match="drive.csv: is a .csv file, not a twin file; give twin.toml, which qcar-twin"):
    load_twin(tmp_path / "drive.csv")
  (tmp_path / "dataset.toml").write_text('name = "x"\n[channels]\n')
  with pytest.raises(ValueError, match="dataset.toml: describes a data set, not a twin; calibrate it first"):
    load_twin(tmp_path / "dataset.toml")
  (tmp_path / "twin.toml").touch()
  with pytest.raises(ValueError, match=r"is a folder; give .*twin.toml"):
    load_twin(tmp_path)
  path = save_twin(tmp_path / "short.toml", Twin(CAR), Twin(CAR).parameters.nominal)
  kept = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("cg_to_rear = ")]
  path.write_text("\n".join(kept), encoding="utf-8")
  with pytest.raises(ValueError, match=r"short.toml: \[vehicle\] lacks cg_to_rear: state"):
    load_twin(path)


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_a_run_goes_on_where_one_ended(engine):
  """Time, hidden states and wheel angles: two runs, or a run and steps, are one run."""
  twin = Twin(CAR, select(["battery_discharge", "steering_delay", "cogging"]), engine=engine)
  theta = twin.parameters.vector({"battery_discharge": 0.3, "steering_delay": 0.03})[None]
  start = np.zeros((1, len(START)))
  commands = np.tile([1.5, 0.2], (200, 1, 1)) * (1.0 + 0.2 * np.sin(0.1 * np.arange(200)))[:, None, None]
  pose, half = np.full((1, 200, 4), np.nan), np.array([100])
  whole = twin.begin(theta, start).run(commands, pose, np.array([200]))
  car = twin.begin(theta, start)
  first, second = (car.run(commands[rows], pose[:, rows], half) for rows in (slice(0, 100), slice(100, 200)))
  np.testing.assert_allclose(np.concatenate([first, second[:, 1:]], axis=1), whole, atol=1e-12)
  car = twin.begin(theta, start)
  car.run(commands[:199], pose, np.array([199]))
  np.testing.assert_allclose(car.step(commands[199])[0], whole[0, -1], atol=1e-12)


def test_other_mechanisms_stay_on_the_simulator_that_was_given(twin: Twin):
  made = lambda size: None
  assert twin.with_engine(made).with_mechanisms(select(["steering_delay"])).engine == "external"


def test_a_start_read_off_the_encoder_follows_the_wheel_radius():
  """Coasting cars with wheels 2 % larger than stated: the motor's first speed is as measured, the car 2 % faster."""
  car = Twin(CAR, select(["wheel_radius_error"]), substeps=2)
  theta = np.stack([car.parameters.nominal, car.parameters.vector({"wheel_radius_error": 0.02})])
  segments = drive(voltage=0.0, steering=(0.0,), seconds=0.1)
  segments = dataclasses.replace(segments, start=np.eye(1, len(START), START.index("velocity_x")))
  true, larger = car.rollout(theta, segments).signals[:, 0, 0]
  assert larger[SIGNALS.index("velocity_x")] == pytest.approx(1.02 * true[SIGNALS.index("velocity_x")])
  assert larger[SIGNALS.index("motor_speed")] == pytest.approx(true[SIGNALS.index("motor_speed")])
  assert segments.start[0, START.index("velocity_x")] == 1.0  # what was measured stays as it was


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
@pytest.mark.parametrize("first", ["steering_offset", "steering_lag"])
def test_a_trim_stands_from_the_start_wherever_it_is_added(first, engine):
  """A car that was under way had its wheels where its trim puts them, behind a lag and a delay as well as before."""
  names = ("steering_offset", "steering_lag", "steering_delay")
  order = (first, *(n for n in names if n != first))
  moved = Twin(CAR, select(order), substeps=2, engine=engine)
  values = {"steering_offset": 0.05, "steering_lag": 0.1, "steering_delay": 0.06}
  segments = drive(steering=(0.0,))
  segments.start[:, START.index("velocity_x")] = 1.0
  angle = moved.rollout(moved.parameters.vector(values), segments).signals[0, 0, :, SIGNALS.index("steering_angle")]
  assert angle[5:] == pytest.approx(0.05, abs=2e-3)  # the servo's own few ms later


def test_a_bent_map_stands_from_the_start_behind_a_lag():
  bent = Twin(CAR, select(["steering_gain_error", "steering_lag"]), substeps=2, engine="reduced")
  segments = drive(steering=(0.2,))
  segments.commands[:, :, 1] = segments.start[:, START.index("steering_angle")] = 0.2
  theta = bent.parameters.vector({"steering_gain_error": -0.25, "steering_lag": 0.2})
  angle = bent.rollout(theta, segments).signals[0, 0, :, SIGNALS.index("steering_angle")]
  assert angle[5:] == pytest.approx(0.15, abs=2e-3)
