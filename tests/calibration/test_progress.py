"""The line on the terminal: stages, shares, messages of fits; warnings stay warnings."""

import logging

from calibration.progress import Progress, StageLine, silent


def test_messages_of_a_fit_follow_the_stage_and_nothing_else_prints_them(capsys, caplog):
  log, before = logging.getLogger("calibration.fitting"), logging.getLogger("calibration").level
  with caplog.at_level(logging.WARNING), StageLine() as line:
    line("scan", 0.5)
    log.info("iteration 1")
    log.warning("beware")
  assert "scan, 50 %: iteration 1" in capsys.readouterr().err
  assert [record.getMessage() for record in caplog.records] == ["beware"]
  assert logging.getLogger("calibration").level == before and logging.getLogger("calibration").propagate


def test_a_stage_without_a_share_is_its_name(capsys):
  with StageLine() as line:
    line("decision")
  assert "decision\n" in capsys.readouterr().err


def test_any_progress_is_told_with_and_without_a_share():
  said: list[tuple[str, float | None]] = []
  listeners: tuple[Progress, ...] = (silent, lambda stage, share=None: said.append((stage, share)))
  for progress in listeners:
    progress("scan", 0.25)
    progress("search")
  assert said == [("scan", 0.25), ("search", None)]
