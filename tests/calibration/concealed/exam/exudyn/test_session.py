"""A session of the rigid-body car is decided by its seed, each effect changes it, and it is fit to be used."""

import numpy as np
import pytest

from calibration.concealed.exam.effects import Concealed
from calibration.concealed.exam.exudyn.car import ExudynCar
from calibration.concealed.exam.exudyn.effects import EXUDYN_EFFECTS
from calibration.concealed.exam.session import make_exam_session, replayed, set_up
from scripts import check
from scripts import make_exam_session as make_exam_session_command
from tests import ROOT
from tests.calibration.concealed.proving_ground.comparing import same

pytest.importorskip("exudyn", reason="Exudyn is not installed (extra `exam`)")


@pytest.fixture(scope="module")
def driven():
  """A setting, a run of the second half of a session, commands that reach stops and slip, and its trace."""
  setting = set_up("exudyn", 5, bench=True)
  run = next(run for run in setting.runs if run.name == "circles_fast")
  run = type(run)(**{**vars(run), "session": "afternoon"})
  tick = np.arange(80)
  commands = np.stack([12.0 * np.sign(np.sin(tick / 9.0)), 0.6 * np.sin(tick / 7.0)], axis=1)
  return setting, run, commands, replayed(setting.car, run, commands)


@pytest.mark.parametrize("name", sorted(EXUDYN_EFFECTS))
def test_each_own_effect_changes_the_run(driven, name):
  setting, run, commands, plain = driven
  effect = EXUDYN_EFFECTS[name]
  changed = replayed(setting.car, run, commands, [Concealed(name, effect, 0.1 * effect.most)])
  assert np.isfinite(changed).all() and np.abs(changed - plain).max() > 1e-3
  barely = replayed(setting.car, run, commands, [Concealed(name, effect, 1e-6 * effect.most)])
  assert np.abs(barely - plain)[:, :6].max() < 1e-3, "a size of next to nothing changes next to nothing"


def test_each_number_that_a_recalibration_moves_changes_the_run(driven):
  setting, run, commands, plain = driven
  for name, number in setting.car.nuisances(setting.std).items():
    changed = replayed(setting.car, run, commands, moved=[(number, number.step)])
    assert np.abs(changed - plain).max() > 1e-5, name
    assert number.std > 0.0


def test_a_payload_keeps_the_place_of_what_was_there():
  car = ExudynCar(np.random.default_rng(1))
  numbers = car.numbers.copied()
  place = numbers.ahead + float(numbers.chassis[1][0]), numbers.height + float(numbers.chassis[1][2])
  EXUDYN_EFFECTS["payload"].act(numbers, 1.5, False)
  assert numbers.mass == pytest.approx(car.numbers.mass + 1.5)
  assert numbers.height + float(numbers.chassis[1][2]) == pytest.approx(place[1])
  assert numbers.ahead > car.numbers.ahead and numbers.whole_yaw_inertia > car.numbers.whole_yaw_inertia


def test_the_seed_decides_every_bit(monkeypatch):
  whole = ExudynCar.runs
  monkeypatch.setattr(ExudynCar, "runs", lambda car, rng: whole(car, rng)[4:6])
  one, again = (make_exam_session("exudyn", 2) for _ in range(2))
  assert same(one, again) and one.truth == again.truth
  assert one.vehicle != set_up("exudyn", 3).vehicle
  assert one.truth["car"]["generator"] == "exudyn" and one.truth["car"]["drag"] == 0.0


@pytest.mark.slow
def test_a_session_without_an_effect_is_fit_to_be_used(tmp_path, capsys):
  data = make_exam_session_command.main(make_exam_session_command.Config(tmp_path / "data", "exudyn", seed=1))
  assert len(data.recordings) == 12
  check.main(check.Config(dataset=tmp_path / "data", out=tmp_path / "checked"))
  assert "Fit to be used" in capsys.readouterr().out


def test_the_page_lists_each_own_effect_with_its_right_names():
  page = (ROOT / "docs" / "reference" / "exam_exudyn.md").read_text(encoding="utf-8")
  rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line.startswith("| ")]
  listed = {row[0]: row[1:] for row in rows if row[0] != "effect"}
  expected = {}
  for name, effect in EXUDYN_EFFECTS.items():
    right = ", ".join(f"`{mechanism}`" for mechanism in effect.right) or "**outside**"
    expected[name] = [effect.part, "exudyn", right, effect.unit]
  assert listed == expected
