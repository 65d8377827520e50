"""What a benchmark of the watch counts, on a watch that says what it is told to say."""

import dataclasses
import types

import numpy as np
import pytest

from calibration.concealed.benchmarks import watch as benchmark
from calibration.concealed.benchmarks.watch import Quiet, Seen, quiet, seen
from calibration.watch.effects import CHANGES
from calibration.watch.watch import Alarm
from scripts import benchmark_watch

GRIP = CHANGES[0]


@dataclasses.dataclass
class Told:
  """A watch that alarms at its third block that shows grip since it was reset."""

  count: int = 0
  taken: int = 0
  theta = np.zeros(2)
  nulls = ()

  def reset(self):
    self.count = 0

  def take(self, recording):
    self.taken += 1
    return [], None, None

  def blocks(self, recording):
    block = lambda k: types.SimpleNamespace(start=2.0 * k, end=2.0 * k + 2.0)
    return [(block(k), frozenset(("grip",) if k % 2 else ())) for k in range(4)]

  def judge(self, block):
    self.count += block.start % 4.0 == 2.0
    return [Alarm(block.end, 0.0, GRIP, -0.19, 15.0)] if self.count == 3 else []


@pytest.fixture(autouse=True)
def sessions(monkeypatch):
  session = types.SimpleNamespace(recordings=[types.SimpleNamespace(start=0.0, duration=8.0)] * 3)
  monkeypatch.setattr(benchmark, "_sessions", lambda car, seed, seeds, change: iter([session] * len(seeds)))
  benchmark._without.cache_clear()


def test_driving_is_counted_until_the_alarm():
  (one,) = seen(Told(), "first", "grip", 1, 1)
  assert one == Seen("grip", 6.0, 12.0, "grip", -0.19)  # two blocks of 2 s of the first recording, one of the second


def test_driving_without_an_alarm_is_said():
  silent = Told()
  silent.judge = lambda block: []
  (one,) = seen(silent, "second", "sag", 1, 1)
  assert one.name == "" and np.isnan(one.size) and one.shown == 0.0


def test_driving_without_a_change_is_counted():
  assert quiet(Told(), "first", 1, 0, 5) == Quiet(120.0, ())


def test_the_page_has_a_row_a_drive_and_nothing_is_watched_twice(monkeypatch, tmp_path):
  watch = Told()
  monkeypatch.setattr(benchmark_watch, "watch_of", lambda car, seed: watch)
  monkeypatch.setattr(benchmark_watch, "share_of_a_core", lambda watch, car, seed: 0.021)
  config = benchmark_watch.Config(tmp_path / "watch.md", sessions=12, trials=2)
  text = benchmark_watch.main(config)
  assert "0 alarms in 0.08 h" in text and text.count("| grip | 6 | 12 | grip |") == 2 and "2.1 %" in text
  assert len((tmp_path / "watch.ndjson").read_text().splitlines()) == 2 + len(benchmark.CHANGES) + 1
  before = watch.taken
  assert benchmark_watch.main(config) == text and watch.taken == before


@pytest.mark.parametrize("car", ["first", "second"])
def test_a_car_with_less_grip_has_less(car, monkeypatch):
  monkeypatch.undo()
  driven = []
  monkeypatch.setattr(benchmark, "make_sessions", lambda specs: driven.extend(s.car for s in specs) or [])
  monkeypatch.setattr(benchmark, "make_second_session", lambda *what: driven.append(what[-1]))
  for change in ("", "grip"):
    list(benchmark._sessions(car, 3, [7], change))
  whole, less = driven
  for name in benchmark._RIGID[car]:
    assert getattr(less, name) == pytest.approx(0.8 * getattr(whole, name))
  assert less.mass == whole.mass
