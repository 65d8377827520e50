"""The film shows the worst stretch with the car where it was recorded; curves are what a twin settles at."""

import numpy as np
import pytest

from calibration.diagnosis.experiment import DrivenRange
from calibration.diagnosis.outcome import Outcome
from calibration.diagnosis.report import demonstration
from calibration.diagnosis.report.curves import curve_chart, identified_curves
from calibration.diagnosis.report.demonstration import demonstrate, recorded_signals, worst_stretch
from calibration.fitting.windows import Cut
from qcar_twin.plant import POSITION, SIGNALS
from qcar_twin.rendering.film import RenderingUnavailable
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests.calibration.diagnosis.diagnosis_results import diagnosis_of

DRIVEN = DrivenRange(command=1.5, slow=0.5, fast=1.2, angle=0.3)
COMMANDS = np.column_stack([np.linspace(-1.0, 3.0, 50), np.linspace(-0.3, 0.3, 50)])


@pytest.fixture(scope="module")
def curves():
  twin = Twin(Vehicle.load(), select(["steering_offset"]), substeps=2, engine="reduced")
  nominal = twin.parameters.nominal
  bent = nominal.copy()
  bent[twin.parameters.index("steering_offset")] = 0.1
  return {
    c.heading.split(" ")[0]: c for c in identified_curves(twin, {"nominal": nominal, "twin": bent}, DRIVEN, COMMANDS)
  }


def test_there_is_a_curve_for_drive_steering_and_tyre(curves):
  assert list(curves) == ["Drive", "Steering", "Tyre"]
  assert curves["Steering"].subsystems == ("steering",)
  speed = curves["Drive"].points["nominal"][1]
  assert np.all(np.diff(speed) >= -1e-6) and speed[0] < 0.0 < speed[-1]


def test_a_mechanism_shows_in_the_curve_of_its_part(curves):
  shift = lambda name: np.max(np.abs(np.subtract(*(curves[name].points[who][1] for who in ("nominal", "twin")))))
  assert shift("Steering") == pytest.approx(np.degrees(0.1), rel=0.15)
  assert shift("Drive") < 0.05
  slip, force = curves["Tyre"].points["nominal"]
  assert np.all(np.diff(slip) >= 0.0) and force[0] < 0.0 < force[-1]


def test_a_curve_that_was_not_driven_is_not_drawn():
  twin = Twin(Vehicle.load(), substeps=2, engine="reduced")
  straight = np.column_stack([COMMANDS[:, 0], np.zeros(50)])
  found = identified_curves(twin, {"nominal": twin.parameters.nominal}, DRIVEN, straight)
  assert [c.heading.split(" ")[0] for c in found] == ["Drive"]
  assert identified_curves(twin, {"nominal": twin.parameters.nominal}, DRIVEN, 0.0 * straight) == []
  assert len(curve_chart(found, {}).traces) == 1


def test_the_worst_stretch_holds_most_evidence(offset_pool, clean_pool):
  observations = offset_pool.problem.observations
  evidence = np.where(observations.stretch == 3, 2.0, 1.0)
  assert worst_stretch(observations, evidence) == 3
  assert worst_stretch(clean_pool.problem.observations, np.ones(len(clean_pool.problem.observations))) is None


def test_the_solid_car_is_where_it_was_recorded(offset_pool):
  observations = offset_pool.problem.observations
  part = observations.stretches.segments[2:3]
  driven = offset_pool.problem.twin.rollout(offset_pool.base.theta[None], part)
  signals = recorded_signals(observations, 2, driven)
  np.testing.assert_array_equal(signals[:, POSITION], part.pose[0, :, :2])
  yaw_speed = np.hypot(*signals[5:-5, 3:5].T)
  np.testing.assert_allclose(yaw_speed, 1.0, rtol=0.05)  # m/s on the unit circle at 1 rad/s
  assert signals.shape == (part.commands.shape[1] + 1, len(SIGNALS))


def outcome_of(pool, claimed=("steering_offset",)):
  d = diagnosis_of(pool, claimed, "explained" if claimed else "no_mismatch")
  return Outcome(d, pool.problem.twin, pool.base.theta, d.model.theta, Cut())


@pytest.fixture
def filmed(monkeypatch):
  """What a film would be made of; curves are another test's."""
  calls = []

  def film(signals, ghosts, period, vehicle):
    calls.append((signals, ghosts, period))
    return b"film", b"still"

  monkeypatch.setattr(demonstration, "identified_curves", lambda *_: [])
  monkeypatch.setattr(demonstration, "comparison_film", film)
  return calls


def test_the_film_has_the_twin_before_and_then_repaired(offset_pool, filmed):
  shown = demonstrate(outcome_of(offset_pool))
  ((signals, ghosts, _),) = filmed
  assert shown.clip is not None and shown.clip.film == b"film" and shown.no_film == ""
  assert "first that of the recalibrated twin (red), then of the repaired twin (blue)" in shown.clip.caption
  assert [label.split("ghost: ")[1] for label, *_ in ghosts] == ["recalibrated twin", "repaired twin"]
  assert all(ghost.shape == signals.shape for *_, ghost in ghosts) and len(signals) == 400


def test_without_a_repair_one_ghost_drives(offset_pool, filmed):
  shown = demonstrate(outcome_of(offset_pool, ()))
  assert len(filmed[0][1]) == 1 and "repaired" not in shown.clip.caption


def test_why_there_is_no_film_is_said_in_a_sentence(offset_pool, clean_pool, filmed, monkeypatch):
  assert "pose_x, pose_y, pose_yaw" in demonstrate(outcome_of(clean_pool, ())).no_film

  def fail(*_):
    raise RenderingUnavailable("no OpenGL through egl; on Debian: apt-get install libegl1")

  monkeypatch.setattr(demonstration, "comparison_film", fail)
  shown = demonstrate(outcome_of(offset_pool))
  assert shown.clip is None
  assert shown.no_film == "There is no film: no OpenGL through egl; on Debian: apt-get install libegl1."
