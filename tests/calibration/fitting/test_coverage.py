"""Which judging recordings have to be fitted since nothing that is fitted goes where they go."""

import numpy as np
import pytest

from calibration.concealed.proving_ground import Spec, make_sessions
from calibration.fitting.coverage import with_coverage
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, Stream

TIME = np.arange(0.0, 5.0, 0.01)


def run(name: str, role: str, steering: float, volts: float = 1.5, seconds: float = 5.0) -> Recording:
  """A sweep of the steering from nought to an angle, rad."""
  time = TIME * seconds / 5.0
  steer = steering * time / time[-1]
  streams = {"motor_voltage": np.full(TIME.size, volts), "steering_command": steer, "speed": np.ones(TIME.size)}
  return Recording(name, {k: Stream(time, v) for k, v in streams.items()}, role=role)


def roles(dataset: DataSet) -> dict[str, str]:
  return {r.name: r.role for r in dataset.recordings}


def test_right_turns_that_nothing_fitted_has_are_fitted_too():
  dataset = DataSet("left", (run("left", "identify", 0.3), run("right", "validate", -0.3), run("end", "holdout", -0.3)))
  made, notes = with_coverage(dataset)
  assert roles(made) == {"left": "identify", "right": "identify", "end": "holdout"}
  assert len(notes) == 1 and "right" in notes[0] and "steering_command" in notes[0]


def test_a_note_names_the_command_that_drives_the_car_and_its_unit():
  def driven(name: str, role: str, command: str, size: float) -> Recording:
    streams = {command: np.full(TIME.size, size), "steering_command": 0.1 * np.sin(TIME), "speed": np.ones(TIME.size)}
    return Recording(name, {k: Stream(TIME, v) for k, v in streams.items()}, role=role)

  for command, said in (("motor_duty", "outside 0.3 to 0.3, and"), ("speed_command", "outside 0.3 to 0.3 m/s, and")):
    runs = [
      driven(role, role, command, size) for role, size in (("identify", 0.3), ("validate", -0.3), ("holdout", 0.3))
    ]
    (note,) = with_coverage(DataSet("forward", tuple(runs)))[1]
    assert f"has {command} {said}" in note


def test_only_as_many_as_are_needed_change_their_role():
  mild, wide = run("mild", "validate", -0.2), run("wide", "validate", -0.4)
  made, notes = with_coverage(DataSet("left", (run("left", "identify", 0.3), mild, wide, run("end", "holdout", 0.2))))
  assert roles(made)["wide"] == "identify" and roles(made)["mild"] == "validate"
  assert len(notes) == 1


def test_of_a_long_recording_the_half_that_goes_farther_is_fitted_and_the_other_judges():
  right, end = run("right", "validate", -0.3, seconds=40.0), run("end", "holdout", -0.3)
  made, notes = with_coverage(DataSet("left", (run("left", "identify", 0.3), right, end)))
  fitted = [r for r in made.role("identify") if r.name != "left"]
  judging = made.role("validate")
  assert fitted and judging and judging[0].end < fitted[-1].start  # the sweep's end is what nothing else shows
  assert fitted[-1].end == right.end and judging[0].start == right.start
  assert sum(len(r.streams["speed"]) for r in (*fitted, *judging)) == len(right.streams["speed"])  # no sample twice
  whole = DataSet("left", (run("left", "identify", 0.3), right, end))
  assert made.recordings[-1].before == pytest.approx(whole.recordings[-1].before)
  for earlier, later in zip(made.recordings[:-1], made.recordings[1:], strict=True):
    assert later.before[0] > earlier.before[0]  # heat and charge are carried on from half to half
  assert "right#2 (20.0 s to 39.9 s)" in notes[0]


def test_what_is_like_itself_throughout_is_cut_once():
  steer = -0.3 * np.sin(2.0 * np.pi * np.linspace(0.0, 40.0, 4001)) ** 2
  time = np.linspace(0.0, 40.0, 4001)
  streams = {"motor_voltage": np.full(time.size, 1.5), "steering_command": steer, "speed": np.ones(time.size)}
  right = Recording("right", {k: Stream(time, v) for k, v in streams.items()}, role="validate")
  made, notes = with_coverage(DataSet("left", (run("left", "identify", 0.3), right, run("end", "holdout", 0.1))))
  assert sorted(r.role for r in made.recordings if r.name.startswith("right#")) == ["identify", "validate"]
  assert len(notes) == 1 and "20.0 s" in notes[0]


def test_a_recording_whose_speed_is_lost_midway_stays_whole():
  right = run("right", "validate", -0.3, seconds=40.0)
  lost = Stream(right["speed"].time[:150], right["speed"].value[:150])
  right = right.replace(streams={**right.streams, "speed": lost})
  made, _ = with_coverage(DataSet("left", (run("left", "identify", 0.3), right, run("end", "holdout", -0.3))))
  assert roles(made) == {"left": "identify", "right": "identify", "end": "holdout"}


def test_a_faster_drive_counts_as_well_as_a_wider_turn():
  slow, fast = run("slow", "identify", 0.3, 1.0), run("fast", "validate", 0.3, 3.0)
  made, notes = with_coverage(
    DataSet("slow", (slow, run("turn", "identify", 0.3, 1.2), fast, run("end", "holdout", 0.2)))
  )
  assert roles(made)["fast"] == "identify" and "motor_voltage" in notes[0]


def circling(name: str, role: str, speed: float) -> Recording:
  """Both commands change, and never both are large; `speed`: m/s at a yaw rate of 1 rad/s, at a tenth else."""
  half = TIME < 0.5 * TIME[-1]
  size = np.where(half, speed, 3.0)
  rate = np.where(half, 1.0, 0.1)
  streams = {"motor_voltage": size, "steering_command": 0.3 * rate, "speed": size, "yaw_rate": rate}
  return Recording(name, {k: Stream(TIME, v) for k, v in streams.items()}, role=role)


def test_going_round_faster_counts_though_each_command_was_there():
  runs = (circling("slow", "identify", 1.0), circling("fast", "validate", 2.5), circling("end", "holdout", 2.5))
  made, notes = with_coverage(DataSet("round", runs))
  assert roles(made) == {"slow": "identify", "fast": "identify", "end": "holdout"}
  assert len(notes) == 1 and "50 % of its driving has the lateral acceleration outside 0.23 to 1.07 m/s^2" in notes[0]


def test_a_hold_out_that_goes_where_nothing_fitted_goes_is_told_and_stays_closed():
  runs = (circling("slow", "identify", 1.0), circling("as_slow", "validate", 1.0), circling("end", "holdout", 2.5))
  made, notes = with_coverage(DataSet("round", runs))
  assert roles(made) == {"slow": "identify", "as_slow": "validate", "end": "holdout"}
  assert len(notes) == 1 and "end is a hold-out recording and goes where nothing that is fitted goes: 50 %" in notes[0]


@pytest.mark.parametrize("role", ["identify", "validate"])
def test_without_a_hold_out_run_roles_stay_as_they_are(role: str):
  dataset = DataSet("left", (run("left", "identify", 0.3), run("right", "validate", -0.3), run("end", role, 0.1)))
  assert with_coverage(dataset) == (dataset, ())


def test_a_car_that_was_not_driven_changes_nothing():
  still = tuple(run(name, role, 0.3, 0.0) for name, role in (("a", "identify"), ("b", "validate"), ("c", "holdout")))
  assert roles(with_coverage(DataSet("still", still))[0]) == {"a": "identify", "b": "validate", "c": "holdout"}


@pytest.mark.slow
def test_designed_sessions_fit_everything_they_judge_by():
  designs = ("compact", "lab", "paper")
  for design, session in zip(designs, make_sessions([Spec(515, (), d, 1.0) for d in designs]), strict=True):
    dataset = DataSet(design, session.recordings, session.vehicle, session.vehicle_std)
    made, notes = with_coverage(dataset)
    assert roles(made) == roles(dataset) and not notes, design


def test_a_hold_out_that_is_told_to_steer_faster_than_anything_fitted_is_told_of():
  slalom, steps = 0.3 * np.sin(2.0 * TIME), 0.3 * np.sign(np.sin(2.0 * TIME))

  def told(name: str, role: str, steering: np.ndarray) -> Recording:
    streams = {"motor_voltage": np.full(TIME.size, 1.5), "steering_command": steering, "speed": np.ones(TIME.size)}
    return Recording(name, {k: Stream(TIME, v) for k, v in streams.items()}, role=role)

  made, notes = with_coverage(DataSet("steps", (told("slow", "identify", slalom), told("end", "holdout", steps))))
  assert roles(made)["end"] == "holdout" and len(notes) == 1
  assert "100 % of the turns of its steering_command go farther than 0.0659 rad in 0.1 s" in notes[0]
  runs = (told("slow", "identify", slalom), told("steps", "validate", steps), told("end", "holdout", steps))
  made, notes = with_coverage(DataSet("steps", runs))
  assert roles(made) == {"slow": "identify", "steps": "identify", "end": "holdout"} and len(notes) == 1


def test_a_car_that_coasts_where_fitted_ones_brake_is_fitted_there_too():
  """What a controller does at neutral is not learnt from drives that end with the brake."""

  def ending(name: str, role: str, last: float, slowing: float) -> Recording:
    drives = TIME < 2.5
    speed = np.where(drives, 1.5, np.maximum(1.5 - slowing * (TIME - 2.5), 0.0))
    streams = {"motor_duty": np.where(drives, 0.2, last), "steering_command": 0.1 * np.sin(TIME), "speed": speed}
    return Recording(name, {k: Stream(TIME, v) for k, v in streams.items()}, role=role)

  brakes, coasts = ending("brakes", "identify", -0.2, 3.0), ending("coasts", "validate", 0.0, 0.4)
  made, notes = with_coverage(DataSet("stops", (brakes, coasts, ending("end", "holdout", -0.2, 3.0))))
  assert roles(made) == {"brakes": "identify", "coasts": "identify", "end": "holdout"}
  assert len(notes) == 1 and "47 % of its driving is coasting faster than 0 m/s, and no recording" in notes[0]
  made, notes = with_coverage(DataSet("stops", (brakes, ending("end", "holdout", 0.0, 0.4))))
  assert roles(made)["end"] == "holdout" and "is coasting faster than 0 m/s" in notes[0]


def test_a_parked_car_coasts_nowhere():
  def parked(name: str, role: str, noise: float) -> Recording:
    streams = {"motor_duty": 0.0 * TIME, "steering_command": 0.0 * TIME, "speed": noise * np.sin(50.0 * TIME)}
    return Recording(name, {k: Stream(TIME, v) for k, v in streams.items()}, role=role)

  drive = run("drive", "identify", 0.3)
  recordings = (drive, parked("quiet", "identify", 0.001), parked("loud", "validate", 0.02), run("end", "holdout", 0.3))
  made, notes = with_coverage(DataSet("parked", recordings))
  assert roles(made)["loud"] == "validate" and not notes
