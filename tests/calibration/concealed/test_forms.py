"""How far the twin's own form moves figures, from what recalibration made of sessions without an effect."""

import numpy as np
import pytest

from calibration.concealed.benchmarks.forms import form_deviations
from calibration.diagnosis.decision.evidence import Measured
from calibration.intervals.forms import read_forms
from scripts import set_forms


def sessions(count, form, std, car="first", seed=1):
  """Sessions whose mass moved by an error of the measurement and one of the form, shares of 3 kg."""
  random = np.random.default_rng(seed)
  moved = 3.0 + 3.0 * np.hypot(std, form) * random.normal(size=count)
  return [(car, [Measured("mass", 3.0, 3.0 * std, float(v), 3.0, "kg")]) for v in moved]


def test_what_measuring_does_not_explain_is_the_forms():
  shares = form_deviations(sessions(4000, 0.05, 0.02))
  assert shares["mass"] == (pytest.approx(0.05, rel=0.05), 4000)
  assert form_deviations(sessions(4000, 0.0, 0.02))["mass"][0] < 0.006


def test_few_sessions_leave_a_wider_form_than_many():
  few = [form_deviations(sessions(8, 0.0, 0.02, seed=k))["mass"][0] for k in range(200)]
  assert np.median(few) > 0.012 and np.mean(np.array(few) > 0.0) > 0.7


def test_every_generator_counts_alike():
  shares = form_deviations(sessions(4000, 0.05, 0.0) + sessions(100, 0.0, 0.0, "second"))
  assert shares["mass"][0] == pytest.approx(0.05 / np.sqrt(2.0), rel=0.05)


def test_others_are_the_root_mean_square_of_what_was_looked_at():
  rows = [("first", [Measured("a", 1.0, 0.0, 1.03, 1.0, "-"), Measured("b", 1.0, 0.0, 1.0, 1.0, "-")])]
  assert form_deviations(rows)["others"] == (pytest.approx(0.03 / np.sqrt(2.0)), 1)


def test_what_the_command_writes_the_decision_reads(tmp_path, monkeypatch):
  known = (Measured("friction_coefficient", 0.9, 0.01, 0.99, 0.9, "-"),)
  both = lambda cars, seeds: [(car, rows, known) for car, rows in sessions(len(cars) * len(seeds), 0.05, 0.02)]
  monkeypatch.setattr(set_forms, "fitted_figures", both)
  out = set_forms.main(set_forms.Config(tmp_path / "forms.toml", seed=7, sessions=4))
  forms = read_forms(out)
  assert set(forms) == {"mass", "friction_coefficient", "others"} and forms["others"] == forms["mass"]
  assert forms["friction_coefficient"] == pytest.approx(np.sqrt(0.1**2 - (0.01 / 0.9) ** 2), abs=1e-4)
  assert "qcar-twin set-forms --seed 7 --sessions 4 --cars first second slipx --out forms.toml" in out.read_text()
