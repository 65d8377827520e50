"""Concealed formulas: none is drawn by a campaign, each acts where it says, and the command writes its page."""

import numpy as np
import pytest

from calibration.concealed.benchmarks.formula import FORMULAS, offered
from calibration.concealed.proving_ground import EFFECTS
from qcar_twin.twin.formula import DEGREES
from qcar_twin.twin.formula.variables import VARIABLES
from scripts import benchmark_formula


def test_they_are_the_generators_only_while_a_session_is_made():
  assert not set(FORMULAS) & set(EFFECTS)
  with offered():
    assert set(FORMULAS) <= set(EFFECTS)
  assert not set(FORMULAS) & set(EFFECTS)


@pytest.mark.parametrize("name", FORMULAS)
def test_a_formula_is_a_function_of_what_it_says(name: str):
  kind, random = FORMULAS[name], np.random.default_rng(0)
  assert kind.degree in DEGREES and kind.depends_on <= set(VARIABLES) and kind.written
  values = {v: random.uniform(0.2, 1.5, 40) for v in VARIABLES}
  before = kind.value_of(values)
  other = {v: x if v in kind.depends_on or v in ("speed", "yaw_rate") else 0.0 * x for v, x in values.items()}
  assert np.isfinite(before).all() and np.array_equal(kind.value_of(other), before)
  assert np.ptp(before) > 0.0


@pytest.mark.slow
def test_the_command_writes_its_page(tmp_path):
  text = benchmark_formula.main(benchmark_formula.Config(tmp_path / "page.md", quick=True))
  assert text == (tmp_path / "page.md").read_text(encoding="utf-8")
  assert text.count("| 71 |") == 2 and "`qcar-twin benchmark-formula --seed 71" in text
