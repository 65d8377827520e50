"""What a free fit's figures are said to mean depends on whether they predict what they were not fitted to."""

from types import SimpleNamespace
from typing import cast

from calibration.diagnosis.curves.naming.terms import Term
from calibration.diagnosis.curves.report.wording import departures
from calibration.diagnosis.curves.study import Study


def said(base: float, characterised: float) -> str:
  terms = [Term("drive_lag", 0.124, 0.012, "s", True), Term("imu_latency", 0.041, 0.006, "s", True)]
  errors = {"base": {"speed": base}, "characterised": {"speed": characterised}}
  return departures(cast(Study, SimpleNamespace(outlines=[], terms=terms, errors=errors, judged={})), ())


def test_figures_that_predict_unseen_driving_better_are_told():
  assert "these stand out: drive_lag 124 ± 12 ms, imu_latency 41.0 ± 6.0 ms." in said(0.2, 0.1)


def test_figures_that_predict_it_worse_say_nothing_of_the_car():
  assert said(0.15, 0.17) == (
    "Free figures predict held-out recordings no better than the base does, so they say nothing of the car."
  )
