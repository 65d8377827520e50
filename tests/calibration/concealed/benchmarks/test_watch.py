"""What a benchmark of the watch counts, on a watch that says what it is told to say."""

import dataclasses
import types

import numpy as np
import pytest

from calibration.concealed.benchmarks import watch as benchmark
from calibration.concealed.benchmarks.watch import Seen, nulls, seen
from calibration.watch.effects import CHANGES
from calibration.watch.watch import Alarm
from scripts import benchmark_watch

GRIP = CHANGES[0]


@dataclasses.dataclass
class Told:
  """A watch that alarms at its third block that shows grip since it was reset."""

  count: int = 0

  def reset(self):
    self.count = 0

  def take(self, recording):
    return [], None, None

  def blocks(self, recording):
    block = lambda k: types.SimpleNamespace(start=2.0 * k, end=2.0 * k + 2.0)
    return [(block(k), frozenset(("grip",) if k % 2 else ())) for k in range(4)]

  def judge(self, block):
    self.count += block.start % 4.0 == 2.0
    return [Alarm(block.end, 0.0, GRIP, -0.19, 15.0)] if self.count == 3 else []


@pytest.fixture(autouse=True)
def sessions(monkeypatch):
  recording = types.SimpleNamespace(start=0.0, duration=8.0)
  monkeypatch.setattr(
    benchmark, "_sessions", lambda car, seed, seeds, change: iter([([recording] * 3, {}, {})] * len(seeds))
  )


def test_driving_is_counted_until_the_alarm():
  (one,) = seen(Told(), "grip", 1, 1)
  assert one == Seen("grip", 6.0, 12.0, "grip", -0.19)  # two blocks of 2 s of the first recording, one of the second


def test_driving_without_an_alarm_is_said():
  quiet = Told()
  quiet.judge = lambda block: []
  (one,) = seen(quiet, "sag", 1, 1)
  assert one.name == "" and np.isnan(one.size) and one.shown == 0.0


def test_nulls_are_hours():
  assert nulls(Told(), "first", 1, 5) == (120.0, [])


def test_the_page_has_a_row_a_drive(monkeypatch, tmp_path):
  monkeypatch.setattr(benchmark_watch, "watch_of", lambda car, seed: Told())
  text = benchmark_watch.main(benchmark_watch.Config(tmp_path / "watch.md", sessions=2, trials=2))
  assert "0 alarms in 0.01 h" in text and text.count("| grip | 6 | 12 | grip |") == 2
