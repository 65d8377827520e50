"""Stages on a terminal and in a log: shares, time left, messages of fits; warnings stay warnings."""

import io
import logging
import sys
import time

import pytest

from calibration import progress as module
from calibration.progress import (
  CALIBRATION,
  CROSS_VALIDATION,
  DIAGNOSIS,
  Progress,
  StageLine,
  Stages,
  counted,
  duration,
  joined,
  silent,
  staged,
  under,
  within,
)
from tests.counting import ticking


class Terminal(io.StringIO):
  """A stream that is written over."""

  def isatty(self) -> bool:
    return True


def on_terminal(monkeypatch) -> Terminal:
  """What stands for the terminal in a test; capturing has its own before it begins."""
  monkeypatch.setattr(sys, "stderr", stream := Terminal())
  return stream


def test_messages_of_a_fit_follow_the_stage_and_nothing_else_prints_them(monkeypatch, caplog):
  terminal = on_terminal(monkeypatch)
  log, before = logging.getLogger("calibration.fitting"), logging.getLogger("calibration").level
  with caplog.at_level(logging.WARNING), StageLine(DIAGNOSIS) as line:
    line("scan", 0.5)
    log.info("iteration 1")
    log.warning("beware")
  assert "stage 2 of 12 · scan, 50 %" in terminal.getvalue() and "left: iteration 1" in terminal.getvalue()
  assert [record.getMessage() for record in caplog.records] == ["beware"]
  assert logging.getLogger("calibration").level == before and logging.getLogger("calibration").propagate


def test_a_log_has_one_plain_line_a_stage(capsys):
  with StageLine(DIAGNOSIS) as line:
    for stage, share in (("recalibration", None), ("scan", 0.1), ("scan", 0.9), ("search", None), ("decision", None)):
      line(stage, share)
      logging.getLogger("calibration.fitting").info("iteration")
  said = capsys.readouterr().err
  assert "\r" not in said and "iteration" not in said
  starts = [text.partition(" · about")[0] for text in said.splitlines()]
  assert starts == ["stage 1 of 12 · recalibration", "stage 2 of 12 · scan", "stage 7 of 12 · decision"]


def test_what_is_printed_between_does_not_end_the_plan(capsys):
  line = StageLine(joined(CALIBRATION, CROSS_VALIDATION))
  for stages in (("identification", "fit taken from an earlier run", "comparison"), ("identification", "free run")):
    with line:
      for stage in stages:
        line(stage)
  numbers = [text.split()[1] for text in capsys.readouterr().err.splitlines()]
  assert numbers == ["1", "2", "3", "4", "6"] and len(joined(CALIBRATION, CROSS_VALIDATION)) == 7


def test_the_time_left_is_what_the_plan_has_left_at_the_pace_of_the_run(monkeypatch):
  monkeypatch.setattr(module, "time", ticking())
  stages = Stages({"first": 10.0, "second": 30.0, "third": 0.0})  # begins at 0 s; every question is a second later
  assert stages.reached("first", None) and stages.left is None  # entered at 1 s
  assert stages.reached("second", None)  # entered at 3 s: 10 s of the plan took 3 s
  assert stages.left == pytest.approx(0.3 * 30.0 - 1.0)
  assert not stages.reached("second, further", 0.5) and stages.left == pytest.approx(5.0 * 15.0 / 25.0)
  assert stages.line("second") == "stage 2 of 3 · second · about 4 s left"
  assert not stages.reached("first", None), "a stage that is past does not come again"
  assert stages.reached("third", None) and stages.line("third") == "stage 3 of 3 · third"


def test_a_stage_without_a_share_does_not_make_the_rest_long_before_it_is(monkeypatch):
  """30 s planned of 100 s, after 10 s that took 10 s: 90 s are left at first, and 60 s when they should be over."""
  clock = [0.0]
  monkeypatch.setattr(module.time, "monotonic", lambda: clock[0])
  stages, left = Stages({"first": 10.0, "long": 30.0, "rest": 60.0}), []
  assert stages.reached("first", None)
  clock[0] = 10.0
  assert stages.reached("long", None)
  for clock[0] in (10.0, 25.0, 40.0, 70.0):
    left.append(stages.left)
  assert left == pytest.approx([90.0, 75.0, 60.0, 70.0 / 40.0 * 60.0])


def test_a_stage_that_was_not_foreseen_says_its_time_left_by_its_share(monkeypatch):
  monkeypatch.setattr(module, "time", ticking())
  stages = Stages({"first": 10.0, "sometimes": 0.0, "last": 20.0})  # begins at 0 s
  assert stages.reached("first", None) and stages.reached("sometimes", 0.0)  # at 1 s and 2 s
  assert stages.left is None  # at 3 s
  assert not stages.reached("sometimes", 0.5)
  # at 4 s: half of it took 2 s, and what follows goes at the pace of the first, 2 s for 10 s
  assert stages.left == pytest.approx(2.0 + 4.0)


def test_a_log_has_a_line_a_minute_where_a_stage_takes_long(monkeypatch, capsys):
  clock = [0.0]
  monkeypatch.setattr(module.time, "monotonic", lambda: clock[0])
  with StageLine({"scan": 0.0, "decision": 1.0}) as line:
    for second in range(0, 190, 10):
      clock[0] = float(second)
      line("scan", second / 190)
    for second in (210, 400):  # a fit that says nothing of its share and goes on
      clock[0] = float(second)
      logging.getLogger("calibration.fitting").info("iteration")
  said = capsys.readouterr().err.splitlines()
  assert [text.partition(" · about")[0] for text in said] == [
    "stage 1 of 2 · scan", "stage 1 of 2 · scan, 37 %", "stage 1 of 2 · scan, 74 %", "stage 1 of 2 · scan, 95 %",
    "stage 1 of 2 · scan, 95 %",
  ]  # fmt: skip
  assert said[-1].endswith("for about 7 min") and len(set(said)) == len(said)
  assert "about 120 s left" in said[1] or "about 2 min left" in said[1]


def test_without_a_plan_a_stage_is_its_name(monkeypatch):
  terminal = on_terminal(monkeypatch)
  with StageLine() as line:
    line("decision")
  assert "decision\n" in terminal.getvalue()


def test_without_a_plan_a_log_has_a_line_for_every_new_stage(capsys):
  with StageLine() as line:
    for stage, share in (("start 1 of 2", None), ("start 2 of 2", 0.1), ("start 2 of 2", 0.9)):
      line(stage, share)
  assert capsys.readouterr().err == "start 1 of 2\nstart 2 of 2\n"


def test_one_of_several_runs_has_its_stages_under_its_name(capsys):
  plan = joined(under("a", CALIBRATION), under("a", CROSS_VALIDATION), under("b", CALIBRATION))
  with StageLine(plan) as line:
    for name, stages in (("a", ("identification", "recalibration", "identification", "free run")), ("b", ("fit 1",))):
      for stage in stages:
        within(name, line)(stage, None)
  texts = [text.partition(" · about")[0] for text in capsys.readouterr().err.splitlines()]
  assert texts == [
    "stage 1 of 10 · a: identification", "stage 2 of 10 · a: recalibration", "stage 4 of 10 · a: identification",
    "stage 6 of 10 · a: free run", "stage 9 of 10 · b: fit 1",
  ]  # fmt: skip


def test_of_calls_that_run_side_by_side_the_first_that_is_not_done_is_the_stage(capsys):
  with StageLine(dict.fromkeys("abc", 1.0)) as line:
    for place, result in staged(iter([(1, "second"), (0, "first"), (2, "third")]), "abc", line):
      line.say(f"{place} {result}")
  said = capsys.readouterr()
  assert said.out == "1 second\n0 first\n2 third\n"
  assert [text.partition(" · about")[0] for text in said.err.splitlines()] == ["stage 1 of 3 · a", "stage 3 of 3 · c"]
  assert "left" in said.err


def test_items_are_counted(monkeypatch):
  terminal = on_terminal(monkeypatch)
  log = io.StringIO()
  assert list(counted(iter("ab"), 2, "case", log)) == ["a", "b"]
  assert log.getvalue() == "case 1 of 2 · about 1 s left\ncase 2 of 2 · about 1 s left\n"
  assert list(counted(iter("ab"), 2, "case")) == ["a", "b"] and "2/2" in terminal.getvalue()
  assert duration(89.0) == "about 89 s" and duration(150.0) == "about 2 min" and time.monotonic() > 0.0


def test_any_progress_is_called_with_and_without_a_share():
  said: list[tuple[str, float | None]] = []
  listeners: tuple[Progress, ...] = (silent, lambda stage, share=None: said.append((stage, share)))
  for progress in listeners:
    progress("scan", 0.25)
    progress("search")
  assert said == [("scan", 0.25), ("search", None)]
