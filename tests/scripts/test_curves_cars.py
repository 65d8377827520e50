"""`curves --compare`, `--leave-sessions-out` and `--starts` on small sessions."""

import dataclasses
import json

import numpy as np
import pytest

from calibration.diagnosis.curves import comparison, left_out, starts
from calibration.diagnosis.curves.comparison import compare_cars, compared
from calibration.diagnosis.curves.flexible import characterise as fit
from calibration.diagnosis.curves.left_out import leave_sessions_out
from calibration.log_check.ready import ready
from qcar_twin.recordings.dataset import DataSet
from scripts import curves
from tests.scripts.tiny_session import write

pytestmark = pytest.mark.slow
TRIM = 0.05  # rad
CARS = {"before": {}, "again": {}, "after": {"steering_offset": {"steering_offset": TRIM}}}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
  """A car, the same car on another day, and with a servo's horn slipped."""
  root = tmp_path_factory.mktemp("cars")
  for seed, (name, concealed) in enumerate(CARS.items()):
    write(root / name, concealed, seed=seed)
  return root


@pytest.fixture(scope="module")
def fits(folders):
  """Each car characterised, the curves' knots at the same places."""
  reach = {"drive_curve_reach": 2.0, "resistance_curve_reach": 1.5, "steering_curve_reach": 0.2}
  return {name: fit(ready(DataSet.load(folders / name))[0], threads=2, most=15.0, reach=reach) for name in CARS}


def test_what_moved_between_two_data_sets_is_named_with_its_size(fits):
  moved = compared(fits["before"], fits["after"])
  assert [m.name for m in moved if m.there] == ["steering_offset"]
  assert moved[0].second[0] - moved[0].first[0] == pytest.approx(TRIM, abs=0.01)


def test_nothing_moves_in_a_car_that_stays_as_it_is(fits):
  moved = compared(fits["before"], fits["again"])
  assert len(moved) > 20 and not any(m.there for m in moved)


def test_what_stopped_at_its_bound_in_one_data_set_is_compared_as_the_bound(fits):
  """A trim that may not go farther than it went, with the deviation that it would have if it might."""
  fitted = fits["before"].fitted
  held = fitted.fit.at_bound | (np.array(fitted.fit.parameters.names) == "steering_offset")
  stopped = dataclasses.replace(fitted, fit=dataclasses.replace(fitted.fit, at_bound=held))
  moved = compared(dataclasses.replace(fits["before"], fitted=stopped), fits["after"])
  assert [m.name for m in moved if m.there] == ["steering_offset"]
  assert moved[0].first == pytest.approx(compared(fits["before"], fits["after"])[0].first, rel=0.1)


@pytest.mark.parametrize(("second", "said"), [("after", "steering_offset: "), ("again", "nothing moved between")])
def test_the_command_writes_a_page_and_says_what_moved(folders, fits, tmp_path, monkeypatch, capsys, second, said):
  asked = []

  def fitted(dataset, reach, **_):
    asked.append(reach)
    return fits["before"] if len(asked) == 1 else fits[second]

  monkeypatch.setattr(comparison, "characterise", fitted)
  config = curves.Config(folders / "before", tmp_path, compare=folders / second)
  assert curves.main(config) is None
  assert asked[0] == asked[1] and asked[0]["steering_curve_reach"] == pytest.approx(0.2, abs=0.01)
  rows = json.loads((tmp_path / "comparison.json").read_text(encoding="utf-8"))
  assert [r["name"] for r in rows if r["there"]] == (["steering_offset"] if second == "after" else [])
  assert said in capsys.readouterr().out and said in (tmp_path / "comparison.html").read_text(encoding="utf-8")


def test_cars_of_another_layout_have_no_counterparts(folders):
  dataset = DataSet.load(folders / "before")
  with pytest.raises(ValueError, match="have no counterparts"):
    compare_cars(dataset, dataclasses.replace(dataset, vehicle={**dataset.vehicle, "layout": "rear"}))


def test_a_session_with_a_trim_of_its_own_is_driven_better_with_it(folders, fits, tmp_path, monkeypatch):
  sets = {day: DataSet.load(folders / name) for day, name in (("monday", "before"), ("tuesday", "after"))}
  recordings = [
    dataclasses.replace(r, name=f"{r.name}_{day}", session=day) for day, d in sets.items() for r in d.recordings
  ]
  both = dataclasses.replace(sets["monday"], recordings=tuple(recordings))

  def others(dataset, **_):
    assert all(r.role != "holdout" for r in dataset.recordings)
    (day,) = {r.session for r in dataset.recordings}
    return fits["before" if day == "monday" else "after"]

  monkeypatch.setattr(left_out, "characterise", others)
  monkeypatch.setattr(curves.DataSet, "load", lambda folder: both)
  curves.main(curves.Config(folders, tmp_path, leave_sessions_out=True, threads=2))
  items = {i["session"]: i for i in json.loads((tmp_path / "sessions.json").read_text(encoding="utf-8"))}
  for item in items.values():  # the other session's trim is wrong for it, and two numbers of its own put that right
    assert item["own"]["yaw_rate"] < 0.5 * item["mean"]["yaw_rate"]
    assert all(np.isfinite(v) and v > 0.0 for v in (*item["mean"].values(), *item["own"].values()))
  assert set(items) == {"monday", "tuesday"}
  assert "Session tuesday" in (tmp_path / "sessions.html").read_text(encoding="utf-8")


def test_leaving_out_takes_two_sessions_and_one_question_at_a_time(folders, tmp_path):
  with pytest.raises(ValueError, match="leaving one out takes two"):
    leave_sessions_out(DataSet.load(folders / "before"))
  config = curves.Config(folders / "before", tmp_path, compare=folders / "again", leave_sessions_out=True)
  with pytest.raises(ValueError, match="one at a time"):
    curves.main(config)


def test_a_fit_from_several_starts_says_what_scatters(folders, fits, tmp_path, monkeypatch, capsys):
  monkeypatch.setattr(starts, "characterise", lambda dataset, **_: fits["before"])
  curves.main(curves.Config(folders / "before", tmp_path, starts=2, threads=2))
  items = json.loads((tmp_path / "starts.json").read_text(encoding="utf-8"))
  costs = [i["cost"] for i in items]
  assert len(items) == 2 and len(set(costs)) == 2  # two fits, not one twice
  drawn = items[1:]
  assert all(i["began"] > 100 * costs[0] for i in drawn)  # far from the car
  assert all(i["cost"] < 0.01 * i["began"] for i in drawn)
  assert all(np.isfinite(v) and v > 0.0 for i in items for v in i["errors"].values()) and items[0]["errors"]
  said = capsys.readouterr().out
  assert "cost [nats]: " in said and "yaw_rate [rad/s]" in said and "standard deviation" in said
  assert "start 2" in (tmp_path / "starts.html").read_text(encoding="utf-8")


def test_one_start_tells_no_spread(folders):
  with pytest.raises(ValueError, match="two starts at least"):
    starts.from_starts(DataSet.load(folders / "before"), 1)
