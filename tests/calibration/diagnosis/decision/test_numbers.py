"""Every number that decides stands in its file, with a source."""

import ast

from tests import ROOT


def test_numbers_that_decide_stand_in_their_file():
  """Where it is decided what is said there is no number but 0, 1 and 2: the others have a source in levels.toml."""
  for path in (ROOT / "calibration" / "diagnosis" / "decision").glob("*.py"):
    numbers = [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Constant)]
    odd = {n.value for n in numbers if isinstance(n.value, (int, float)) and n.value not in (0, 1, 2)}
    assert not odd, f"{path.name}: {odd}"
