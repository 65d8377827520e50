"""The check of an hour of driving is to take 20 s of processor time; a part of an hour takes that part of it."""

from tests.faults.long_log import cost


def test_a_part_of_an_hour_is_checked_in_that_part_of_20_s(tmp_path):
  spent, check = cost(600.0, tmp_path)
  assert spent < 20.0 * 600.0 / 3600.0
  assert not check.of("spoils") and len([c for c in check.comparisons if not c.why_not]) == 5
