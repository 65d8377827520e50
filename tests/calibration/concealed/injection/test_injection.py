"""Changes put into recordings are exactly what they say, halves share nothing, and trials are counted by the rule."""

import dataclasses

import numpy as np
import pytest

from calibration.concealed.injection.halves import halves
from calibration.concealed.injection.into import IMU, INJECTIONS, fitting, injected
from calibration.concealed.injection.page import counts, page
from calibration.concealed.injection.trials import Bench, Fitted, came_back, drawn, kept, own_share
from qcar_twin.atomic_io import write_json
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from scripts import exam_real

TIME = np.arange(0.0, 20.0, 0.02)
COLUMNS = {
  "motor_voltage": np.sign(np.sin(TIME)), "steering_command": 0.2 * np.sin(2.0 * TIME), "motor_speed": 50.0 + TIME,
  "accel_x": np.cos(TIME), "accel_y": np.sin(3.0 * TIME), "yaw_rate": np.sin(TIME),
  "pose_x": TIME, "pose_y": 0.1 * TIME, "pose_yaw": 0.01 * TIME,
}  # fmt: skip


def recording(name="drive", **about):
  return Recording.from_columns(name, TIME, COLUMNS, **about)


CAR = {"mass": 2.7, "yaw_inertia": 0.03, "cg_to_front": 0.128, "cg_to_rear": 0.128, "track_width": 0.17,
       "cg_height": 0.045, "wheel_radius": 0.033, "gear_ratio": 0.1, "max_steering": 0.5}  # fmt: skip
ONE = DataSet("one", (recording(),), CAR)

CHANGED = {
  "steering_dead_time": ({"steering_command"}, lambda s: Stream(s.time - 0.1, s.value)),
  "drive_dead_time": ({"motor_voltage"}, lambda s: Stream(s.time - 0.1, s.value)),
  "steering_gain": ({"steering_command"}, lambda s: Stream(s.time, s.value / 1.1)),
  "steering_trim": ({"steering_command"}, lambda s: Stream(s.time, s.value - 0.1)),
  "gyro_gain": ({"yaw_rate"}, lambda s: Stream(s.time, 1.1 * s.value)),
  "gyro_offset": ({"yaw_rate"}, lambda s: Stream(s.time, s.value + 0.1)),
  "accel_offset": ({"accel_x"}, lambda s: Stream(s.time, s.value + 0.1)),
  "wheels_read_less": ({"motor_speed"}, lambda s: Stream(s.time, s.value / 1.1)),
  "wheels_age": ({"motor_speed"}, lambda s: Stream(s.time + 0.1, s.value)),
  "imu_age": (set(IMU), lambda s: Stream(s.time + 0.1, s.value)),
  "imu_held": (set(IMU), lambda s: Stream(s.time, np.repeat(s.value[::5], 5))),
  "clock_drift": (
    {"motor_speed", *IMU, "pose_x", "pose_y", "pose_yaw"}, lambda s: Stream(1.1 * s.time, s.value)
  ),
}  # fmt: skip


@pytest.mark.parametrize("name", INJECTIONS)
def test_an_injection_changes_what_it_says_and_nothing_else(name):
  channels, change = CHANGED[name]
  (after,) = injected(ONE, INJECTIONS[name], 0.1).recordings
  for channel, stream in ONE.recordings[0].streams.items():
    wanted = change(stream) if channel in channels else stream
    assert after[channel].time == pytest.approx(wanted.time, abs=1e-12), channel
    assert after[channel].value == pytest.approx(wanted.value, abs=1e-12), channel


def test_only_what_has_a_channel_is_injected():
  blind = DataSet(
    "blind", (recording().replace(streams={n: ONE.recordings[0][n] for n in ("motor_voltage", "motor_speed")}),)
  )
  assert set(fitting(blind)) == {"drive_dead_time", "wheels_age", "clock_drift"}
  assert fitting(ONE) == INJECTIONS


def test_where_ages_are_counted_from_the_wheels_late_wheels_are_all_else_early():
  without = DataSet(
    "open", (recording().replace(streams={n: s for n, s in ONE.recordings[0].streams.items() if "pose" not in n}),)
  )
  late = fitting(without)["wheels_age"]
  assert late.shows == {"imu_latency": -1.0, "pose_latency": -1.0, "drive_delay": 1.0, "steering_delay": 1.0}
  assert "encoder_latency" in late.right and fitting(without)["imu_age"] == INJECTIONS["imu_age"]


def test_halves_share_nothing_and_leave_the_hold_out_shut():
  runs = [recording(f"step_{i}", manoeuvre="voltage_step") for i in range(6)]
  runs += [recording(f"free_{i}", role="validate") for i in range(4)] + [recording("last", role="holdout")]
  first, second = halves(DataSet("many", tuple(runs), CAR), np.random.default_rng(0))
  names = [[r.name for r in half.recordings] for half in (first, second)]
  assert sorted(names[0] + names[1]) == sorted(r.name for r in runs if r.role != "holdout")
  for half in names:
    assert sum(n.startswith("step") for n in half) == 3 and sum(n.startswith("free") for n in half) == 2
  assert halves(DataSet("many", tuple(runs), CAR), np.random.default_rng(1))[0].recordings != first.recordings


def test_one_long_recording_is_cut_first():
  first, second = halves(
    dataclasses.replace(ONE, recordings=(recording("a"), recording("b"))), np.random.default_rng(0)
  )
  spans = [(r.name[0], r.start, r.end) for half in (first, second) for r in half.recordings]
  assert len(spans) == 6 and len(set(spans)) == 6
  assert sum(end - start for _, start, end in spans) == pytest.approx(2 * 20.0, rel=0.01)
  with pytest.raises(ValueError, match="too few"):
    halves(ONE, np.random.default_rng(0))


ESTIMATES = {"gyro_scale": (0.02, 0.005), "steering_curve_left_3": (0.1, 0.03), "steering_curve_left_1": (0.0, 0.03),
             "drive_delay": (0.05, 0.01)}  # fmt: skip


def fit(estimates=ESTIMATES, **shares):
  return Fitted(estimates, dict.fromkeys(estimates, "-"), dict.fromkeys(estimates, 1.0) | shares)


def test_sizes_are_drawn_in_nats_of_the_difference_of_two_fits():
  for seed in range(20):
    size, nats = drawn(INJECTIONS["gyro_gain"], fit(), np.random.default_rng(seed))
    assert 0.5 * (size / (np.sqrt(2.0) * 0.005)) ** 2 == pytest.approx(nats)
    assert nats <= 500.0 and abs(size) <= 0.4
  assert drawn(INJECTIONS["clock_drift"], fit(), np.random.default_rng(0))[1] is None


def test_what_the_prior_says_is_worth_no_nats():
  half, none = own_share(0.5**0.5, 1.0), own_share(0.0031, 0.003)
  assert half == pytest.approx(0.5) and none == 0.0
  (size, nats), (whole, same) = (
    drawn(INJECTIONS["gyro_gain"], fit(gyro_scale=c), np.random.default_rng(3)) for c in (half, 1.0)
  )
  assert size == pytest.approx(2.0 * whole) and nats == pytest.approx(same), "it must be twice as large"
  assert drawn(INJECTIONS["gyro_gain"], fit(gyro_scale=none), np.random.default_rng(3))[1] is None
  other = fit(ESTIMATES | {"gyro_scale": (0.07, 0.005)})
  assert came_back(INJECTIONS["gyro_gain"], fit(gyro_scale=half), other)[0] == pytest.approx(0.1)
  assert came_back(INJECTIONS["gyro_gain"], fit(gyro_scale=none), other) == (None, None)


def test_a_gain_comes_back_from_all_knots_that_it_moves():
  other = fit(ESTIMATES | {"steering_curve_left_3": (0.2, 0.03), "steering_curve_left_1": (0.1 / 3.0, 0.03)})
  back, std = came_back(INJECTIONS["steering_gain"], fit(), other)
  assert back == pytest.approx(0.1) and std == pytest.approx(0.03 * np.sqrt(2.0 / (1.0 + 1.0 / 9.0)))
  assert came_back(INJECTIONS["imu_age"], fit(), other) == (None, None)


def moved(*names):
  return [{"name": name} for name in names]


TRIALS = [
  {"trial": "split_000", "moved": [], "numbers": 40},
  {"trial": "split_001", "moved": moved("mass"), "numbers": 40},
  {"trial": "injection_000", "effect": "gyro_gain", "size": 0.1, "unit": "-", "nats": 80.0, "back": 0.11,
   "back_std": 0.01, "moved": moved("gyro_scale", "mass"), "right": ["gyro_scale"]},
  {"trial": "injection_001", "effect": "gyro_gain", "size": 0.1, "unit": "-", "nats": 30.0, "back": 0.05,
   "back_std": 0.01, "moved": moved("mass", "gyro_scale"), "right": ["gyro_scale"]},
  {"trial": "injection_002", "effect": "imu_age", "size": 0.01, "unit": "s", "nats": 6.0, "back": 0.0, "back_std": 0.01,
   "moved": [], "right": ["imu_latency"]},
  {"trial": "injection_003", "effect": "imu_age", "size": 0.1, "unit": "s", "nats": 90.0, "refused": "no", "moved": []},
]  # fmt: skip


def test_trials_are_counted_by_the_rule():
  told = {said: (hits, of) for said, hits, of in counts(TRIALS)}
  assert told["halves between which nothing was changed: something is said to differ"] == (1, 2)
  assert told["injections of 20 nats and more: something is said to differ"] == (2, 2)
  assert told["of those: the surest difference has the right name"] == (1, 2)
  assert told["of those: a right name is among the differences"] == (2, 2)
  assert told["of those with the right name first: size within 20%"] == (1, 1)
  assert told["of all that are said to differ: a wrong name first"] == (1, 2)
  assert told["injections that the check of the log refuses to compare"] == (1, 4)
  text = page("car", TRIALS, "qcar-twin exam-real")
  assert "refused: no" in text and "gyro_scale, mass" in text and "split_001" in text


@pytest.fixture
def answered(tmp_path, monkeypatch):
  """A bench whose fits are given: every number of the untouched set, but for what was put in."""
  calls = []

  def told(self, name, dataset):
    calls.append(name)
    if name == "injection_001":
      raise RecordingError("two sensors contradict each other")
    names = [n for one in INJECTIONS.values() for n in one.shows]
    values = {n: (0.01, 0.001) for n in names}
    if name.startswith("injection"):
      values["steering_delay"] = (0.2, 0.001)
    write_json(tmp_path / "seen.json", {"last": name})
    return fit(values)

  monkeypatch.setattr(Bench, "fitted", told)
  monkeypatch.setattr(DataSet, "load", classmethod(lambda cls, folder: ONE))
  return calls


def test_trials_go_on_where_they_stopped(tmp_path, answered, monkeypatch):
  several = DataSet("one", tuple(recording(f"r{i}") for i in range(8)), CAR)
  monkeypatch.setattr(DataSet, "load", classmethod(lambda cls, folder: several))
  config = exam_real.Config(tmp_path / "data", tmp_path / "real", injections=1, splits=1)
  exam_real.main(config)
  report = exam_real.main(dataclasses.replace(config, injections=2))
  assert answered == ["untouched", "injection_000", "split_000_first", "split_000_second", "untouched", "injection_001"]
  trials = {t["trial"]: t for t in kept(tmp_path / "real")}
  assert [m["name"] for m in trials["injection_000"]["moved"]] == ["steering_delay"]
  assert trials["injection_000"]["back"] == pytest.approx(0.19)
  assert "contradict" in trials["injection_001"]["refused"] and trials["split_000"]["moved"] == []
  assert "nothing" in report.read_text() and "refused" in report.read_text()
