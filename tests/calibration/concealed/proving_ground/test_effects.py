"""Contracts over the registry of effects, and the physics of single ones."""

import numpy as np
import pytest

from calibration.concealed.proving_ground import EFFECTS, Car, ProvingGroundPlant, Spec, make_session, make_sessions
from calibration.concealed.proving_ground.effects.base import Effect, towards
from tests.calibration.concealed.proving_ground.ablation import NOISE
from tests.calibration.concealed.proving_ground.comparing import differences, same

CATALOGUE = """steering_lag steering_delay steering_rate_limit steering_offset steering_gain_error steering_asymmetry
steering_nonlinearity steering_backlash steering_dead_zone steering_quantisation steering_compliance tyre_relaxation
tyre_saturation longitudinal_slip wheel_radius_error load_transfer combined_slip friction_change friction_patch
side_force floor_slope drive_dead_zone drive_lag drive_delay coulomb_friction stiction steering_drag differential_lock
quadratic_drag battery_sag battery_discharge motor_heating coast_freewheel drive_asymmetry driveline_backlash cogging
cg_lateral_offset payload imu_misalignment imu_lever_arm gyro_scale accel_bias gyro_bias pose_latency imu_latency
clock_drift pose_mount steering_saturation drive_chopped wheel_drag""".split()
IDS = sorted(EFFECTS)
POSE_NOISE = {"pose_x": 0.006, "pose_y": 0.006}
NEEDS_A_WHOLE_SESSION = ("battery_discharge", "clock_drift", "friction_change", "friction_patch", "motor_heating")
EVENTS = ("radio_dropout", "stiction", "steering_quantisation")  # small ones still move single samples
EDGE = {"motor_speed": 0.8, "motor_voltage": 0.01, "steering_command": 1e-3, "accel_x": 0.05, "accel_y": 0.05}
PLAIN = Car(copper=0.0, discharge=0.0)


@pytest.fixture(scope="module")
def made() -> dict:
  """(effect id, size) -> tiny session without noise; ("", 0.0) is the one without effects."""
  keys = [("", 0.0), *[(name, size) for size in (1.0, 0.01, 0.0) for name in IDS]]
  specs = [Spec(21, ((name, size),) if name else (), "tiny", 0.0) for name, size in keys]
  return dict(zip(keys, make_sessions(specs), strict=True))


@pytest.fixture(scope="module")
def whole() -> dict:
  """Effect id -> compact session at size 1 without noise, for the effects that need one."""
  specs = [Spec(21, ((name, 1.0),) if name else (), "compact", 0.0) for name in ["", *NEEDS_A_WHOLE_SESSION]]
  return dict(zip(["", *NEEDS_A_WHOLE_SESSION], make_sessions(specs), strict=True))


def drive(effects=(), volts=1.5, steer=(0.0,), seconds=2.0, car=PLAIN) -> np.ndarray:
  """Signals (N, T + 1, 10) from rest; `volts` and `steer`: numbers, (T,) or, for N cars, (N, 1) or (N, T)."""
  ticks = round(seconds / 0.01)
  volts, steer = np.broadcast_arrays(np.atleast_2d(volts), np.atleast_2d(steer), np.empty((1, ticks)))[:2]
  run = ProvingGroundPlant(car, effects).begin(np.zeros((len(volts), 7)))
  commands = np.stack([volts, steer], axis=2)
  return np.stack([run.signals] + [run.step(commands[:, k]) for k in range(ticks)], axis=1)


def nats(base, session) -> dict[str, float]:
  """Half the squared change over the noise, by channel."""
  change = differences(base, session)
  samples = {c: sum(len(r[c]) for r in base.recordings) for c in change}
  return {c: 0.5 * samples[c] * (change[c] / noise) ** 2 for c, noise in (NOISE | POSE_NOISE).items()}


def test_every_id_of_the_catalogue_is_there():
  assert {name for name in IDS if EFFECTS[name].catalogue} == set(CATALOGUE)


def test_at_least_eight_effects_lie_outside_the_catalogue():
  assert sum(not EFFECTS[name].catalogue for name in IDS) >= 8


@pytest.mark.parametrize("name", IDS)
def test_an_effect_says_what_it_is(name):
  kind = EFFECTS[name]
  assert kind.subsystem in ("steering", "tyre", "ground", "drive", "body", "sensor", "command")
  assert kind.typical != 0 and kind.unit and kind.parameter
  assert kind.__doc__ and kind.__doc__ != Effect.__doc__
  assert any(
    kind(1.0, slice(0, 1), np.random.default_rng(0)).implements(h)
    for h in ("prepare", "begin", "act", "link", "load", "contact", "sense")
  )


@pytest.mark.parametrize("name", IDS)
def test_the_truth_of_an_effect_scales_with_its_size(name):
  small, large = (EFFECTS[name](size, slice(0, 1), np.random.default_rng(3)).truth() for size in (0.5, 1.0))
  assert set(small) == set(large)
  assert any(large[key] == pytest.approx(2 * small[key]) and large[key] != 0 for key in large)


def test_size_zero_is_absence_bit_for_bit(made):
  bare = made["", 0.0]
  assert all(same(bare, made[name, 0.0]) for name in IDS)
  assert all(made[name, 0.0].truth["effects"] == [] for name in IDS)


@pytest.mark.parametrize("name", [name for name in IDS if name not in NEEDS_A_WHOLE_SESSION])
def test_an_effect_of_typical_size_shows_within_seconds(name, made):
  evidence = nats(made["", 0.0], made[name, 1.0])
  assert all(np.isfinite(value) for value in evidence.values())
  assert max(evidence.values()) > 15, evidence


@pytest.mark.slow
@pytest.mark.parametrize("name", NEEDS_A_WHOLE_SESSION)
def test_an_effect_that_needs_time_or_place_shows_in_a_session(name, whole):
  evidence = nats(whole[""], whole[name])
  assert max(evidence.values()) > 100, evidence


@pytest.mark.parametrize("name", [name for name in IDS if name not in EVENTS])
def test_an_effect_fades_with_its_size(name, made):
  """A hundredth of the size changes the log by less than a third of what the whole does, beyond the encoder's edges."""
  small, whole = (differences(made["", 0.0], made[name, size]) for size in (0.01, 1.0))
  assert all(small[c] <= 0.34 * whole[c] + EDGE.get(c, 2e-3) for c in small), (small, whole)


def test_an_unknown_effect_is_refused_with_the_nearest_name():
  with pytest.raises(KeyError, match="did you mean 'steering_delay'"):
    make_session(0, (("steering_dealy", 1.0),))


def test_an_unsigned_effect_refuses_a_negative_size():
  with pytest.raises(ValueError, match="payload.*no negative size"):
    EFFECTS["payload"](-1.0, slice(0, 1), np.random.default_rng(0))


def test_towards_relaxes_exactly():
  assert towards(np.array(1.0), np.array(0.0), 0.3, 0.1) == pytest.approx(np.exp(-3))


def test_steering_delay_shifts_the_road_wheels_by_its_seconds():
  steer = 0.1 * np.sin(2 * np.pi * 0.8 * 0.01 * np.arange(150))
  bare, late = (drive(e, 0.0, steer, 1.5)[0, :, 9] for e in ((), (("steering_delay", 1.0),)))
  time = 0.01 * np.arange(len(bare))
  assert late[60:] == pytest.approx(np.interp(time - 0.040, time, bare)[60:], abs=2e-4)


@pytest.mark.parametrize("seconds", [0.0123, 0.001, 0.0557])
def test_a_delay_is_not_bound_to_whole_steps(seconds):
  steer = 0.2 * 0.01 * np.arange(60)
  size = seconds / EFFECTS["steering_delay"].typical
  bare, late = (drive(e, 0.0, steer, 0.6)[0, -1, 9] for e in ((), (("steering_delay", size),)))
  assert (bare - late) / 0.2 == pytest.approx(seconds, abs=1e-3)


def test_steering_lag_has_the_first_moment_it_states():
  late, bare = (drive(e, 0.0, 0.05, 0.6)[0, :, 9] for e in ((("steering_lag", 1.0),), ()))
  assert 0.01 * np.sum(bare - late) / 0.05 == pytest.approx(0.055, abs=2e-3)


def test_the_rate_limit_is_reached_and_never_exceeded():
  signal = drive((("steering_rate_limit", 1.0),), 0.0, 0.3, 0.2)[0, :, 9]
  rate = 1.0 / EFFECTS["steering_rate_limit"].typical
  assert 0.9 * rate < np.max(np.diff(signal)) / 0.01 <= 1.02 * rate


def test_offset_gain_and_asymmetry_to_either_side():
  steer = np.array([[0.2], [-0.2]])
  effects = ((), (("steering_offset", 1.0),), (("steering_gain_error", -1.0),), (("steering_asymmetry", 1.0),))
  bare, offset, gain, tilt = (drive(e, 0.0, steer, 0.2)[:, -1, 9] for e in effects)
  assert offset - bare == pytest.approx(np.deg2rad([2.0, 2.0]), rel=0.03)
  assert gain / bare == pytest.approx([0.92, 0.92], abs=5e-3)
  assert tilt / bare == pytest.approx([1.1, 0.9], abs=2e-3)


def test_nonlinearity_loses_its_share_at_lock_and_nothing_about_the_centre():
  angle = np.array([[PLAIN.max_steering], [0.02]])
  road = drive((("steering_nonlinearity", 1.0),), 0.0, angle, 0.2)[:, -1, 9]
  assert road / angle[:, 0] == pytest.approx([0.9, 1.0], abs=0.01)


def test_backlash_leaves_a_loop_of_its_width():
  steer = np.interp(np.arange(120), [0, 20, 60, 100, 120], [0.0, 0.1, 0.0, -0.1, -0.1])
  steer = np.r_[steer, np.linspace(-0.1, 0.0, 40), np.zeros(20)]
  road = drive((("steering_backlash", 1.0),), 0.0, steer, 1.8)[0, :, 9]
  lag = 0.1 / 0.4 * 7e-3  # servo and pin, at the rate of the ramp
  assert road[60] - road[-1] == pytest.approx(np.deg2rad(1.5) + lag, rel=0.06)


def test_the_dead_zone_swallows_small_commands_only():
  road = drive((("steering_dead_zone", 1.0),), 0.0, np.array([[0.01], [0.2], [-0.2]]), 0.2)[:, -1, 9]
  assert abs(road[0]) < 2e-3
  assert road[1:] == pytest.approx([0.2 - np.deg2rad(1.5), np.deg2rad(1.5) - 0.2], abs=1e-3)


def test_quantisation_holds_within_its_band():
  steer = np.where(np.arange(60) < 30, 0.1, 0.1 + 0.8 * np.deg2rad(0.75))
  road = drive((("steering_quantisation", 1.0),), 0.0, steer, 0.6)[0, :, 9]
  assert abs(road[-1] - road[29]) < 1e-5
  assert road[29] == pytest.approx(0.1, abs=0.11 * np.deg2rad(0.75))


def test_compliance_turns_the_wheels_back_and_widens_the_turn():
  soft, stiff = (drive(e, 1.6, 0.12, 1.5)[0, -1] for e in ((("steering_compliance", 1.0),), ()))
  assert soft[9] < stiff[9] - 5e-3
  assert soft[5] < stiff[5]


def test_the_drive_dead_zone_takes_its_voltage():
  volts = np.array([[1.9], [2.0], [2.1]])
  bare, less = (drive(e, volts, seconds=2.0)[:, -1, 8] for e in ((), (("drive_dead_zone", 1.0),)))
  assert (bare[1] - less[1]) / ((bare[2] - bare[0]) / 0.2) == pytest.approx(0.15, rel=0.03)


def test_the_freewheel_coasts_further():
  volts = np.where(np.arange(150) < 80, 1.5, 0.0)
  bare, free = (drive(e, volts, seconds=1.5)[0, -1, 3] for e in ((), (("coast_freewheel", 1.0),)))
  assert free > bare + 0.2


def test_drive_asymmetry_weakens_reverse_only():
  volts = np.array([[1.5], [-1.5]])
  weak, bare = (drive(e, volts, seconds=0.6)[:, -1, 3] for e in ((("drive_asymmetry", 1.0),), ()))
  assert weak[0] / bare[0] == pytest.approx(1.0, abs=1e-6)
  assert 0.85 < weak[1] / bare[1] < 0.92
  effect = EFFECTS["drive_asymmetry"](1.0, slice(0, 1), np.random.default_rng(0))
  assert effect.truth()["drive_asymmetry"] < 0.0 < effect.value  # stated as the gain backwards


@pytest.mark.parametrize(
  "name", ["coulomb_friction", "quadratic_drag", "steering_drag", "yaw_drag", "battery_sag", "stiction", "wheel_drag"]
)
def test_what_resists_slows_the_car(name):
  slow, fast = (drive(e, 1.2, 0.2, 0.8)[0, -1, 3] for e in (((name, 1.0),), ()))
  assert slow < fast


@pytest.mark.parametrize("name", [n for n in IDS if EFFECTS[n].catalogue])
def test_a_standing_car_without_commands_stays(name, made):
  """Nothing in the catalogue moves a car that nobody drives, but for the give of tyres and gears on a slope."""
  still = made[name, 1.0].clean["standstill"]
  assert np.hypot(still[-1, 0], still[-1, 1]) < 1e-3
  assert np.hypot(still[-1, 3], still[-1, 4]) < 1e-3


SYMMETRIC = """steering_lag steering_backlash tyre_relaxation tyre_saturation combined_slip differential_lock
steering_drag payload steering_compliance longitudinal_slip load_transfer yaw_drag tyre_temperature""".split()


@pytest.mark.parametrize("name", SYMMETRIC)
def test_symmetric_effects_keep_the_mirror_image(name):
  left, right = drive(((name, 1.0),), 1.6, np.array([[0.15], [-0.15]]), 0.6)[:, -1]
  mirror = np.array([1, -1, -1, 1, -1, -1, 1, -1, 1, -1])
  kept = [0, 1, 2, 3, 4, 5, 8, 9]  # the IMU sits off the centre line
  assert left[kept] == pytest.approx((mirror * right)[kept], rel=1e-7, abs=1e-9)


def test_a_payload_is_seen_by_the_linearised_car(made):
  light, heavy = (made[key].truth["linearised"]["P1"] for key in (("", 0.0), ("payload", 1.0)))
  assert heavy < 0.92 * light


def test_a_slope_shows_in_the_accelerometer_of_a_standing_car(made):
  session = made["floor_slope", 1.0]
  pull = session.truth["effects"][0]["parameters"]
  still = session.recordings[0]
  assert still["accel_x"].value[5:18].mean() == pytest.approx(-pull["floor_slope_x"], abs=0.04)
  assert still["accel_y"].value[5:18].mean() == pytest.approx(-pull["floor_slope_y"], abs=0.04)
  assert abs(made["", 0.0].recordings[0]["accel_x"].value[:18]).max() < 1e-9


def test_sensor_effects_leave_the_motion_alone(made):
  for name in IDS:
    if EFFECTS[name].subsystem == "sensor":
      base, other = made["", 0.0].clean, made[name, 1.0].clean
      assert all(np.array_equal(base[run][:, :6], other[run][:, :6]) for run in base), name


@pytest.mark.parametrize(("name", "channel", "column"), [("imu_latency", "yaw_rate", 5), ("pose_latency", "pose_x", 0)])
def test_latencies_shift_their_streams_by_their_seconds(name, channel, column, made):
  late = made[name, 1.0]
  for run in late.recordings[1:]:
    truth, stream = late.clean[run.name][:, column], run[channel]
    moved = np.interp(stream.time - 0.055, 0.01 * np.arange(len(truth)), truth)
    assert np.median(np.abs(stream.value - moved)) < 1e-3


def test_the_friction_patch_acts_only_inside():
  starts = np.zeros((2, 7))
  starts[1, :2] = 50.0
  run = ProvingGroundPlant(PLAIN, (("friction_patch", 1.0),)).begin(starts)
  run.step(np.zeros((2, 2)))
  grip = run._sim.dynamics.grip
  assert np.all(grip[:, 1] == 1.0)
  assert 0.6 <= grip[:, 0].min() < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["battery_discharge", "motor_heating"])
def test_discharge_and_heating_grow_over_the_session(name, whole):
  base, session = whole[""].clean, whole[name].clean
  early, late = (
    np.abs(session[run][:, 8] - base[run][:, 8]).mean() / np.abs(base[run][:, 8]).mean()
    for run in ("voltage_steps", "throttle_in_turn")
  )
  assert late > 1.2 * early
