"""What recalibration made of measured figures, and what the page says of those that the driving contradicts."""

import dataclasses
from types import SimpleNamespace

import numpy as np

from calibration.diagnosis.decision.departures import Departure, departures
from calibration.diagnosis.decision.evidence import Measured
from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.report.grounds import priors
from calibration.diagnosis.report.page import verdict
from calibration.diagnosis.report.wording import departures_sentence
from calibration.diagnosis.score import clustered_std
from calibration.diagnosis.search.gather import measured_figures
from qcar_twin.pages.numbers import spread
from qcar_twin.parameters import ParameterSet
from qcar_twin.twin.mechanisms import select
from tests.calibration.diagnosis import diagnosis_rig as rig
from tests.calibration.diagnosis.diagnosis_results import diagnosis_of

FORMS = {"others": 0.0}


def test_a_car_whose_mass_is_not_what_was_measured_stands_out():
  recordings = rig.measure(rig.LinearTwin(), rig.drive(), {"mass": 3.8}, noise=0.2)
  figures = measured_figures(rig.solved(rig.problem_of(rig.LinearTwin(), recordings)), rig.LinearTwin())
  first = departures(figures, usual_levels(), FORMS)[0]
  assert first.name == "mass" and first.value > first.measured and first.z > 7.0


def test_a_car_as_it_was_measured_contradicts_nothing(clean_pool):
  assert not departures(measured_figures(rig.solved(clean_pool.problem), rig.LinearTwin()), usual_levels(), FORMS)


def test_figures_are_those_that_somebody_measured(clean_pool):
  base = rig.solved(clean_pool.problem)
  names = {f.name for f in measured_figures(base, rig.LinearTwin())}
  assert names == {p.name for p in base.free if p.kind == "measured" and p.null is None} != set()
  free = type(base.free)(p for p in base.free if p.name not in names)
  keep = [base.free.index(p.name) for p in free]
  bare = dataclasses.replace(base, free=free, values=base.values[keep], jacobian=base.jacobian[:, keep])
  assert measured_figures(bare, rig.LinearTwin()) == ()


def test_the_age_of_a_sensor_is_held_against_what_is_usual_whatever_prior_the_log_gave_it():
  (mechanism,) = select(["encoder_latency"])
  (usual,) = mechanism.sensor_errors.values()
  free = ParameterSet([dataclasses.replace(mechanism.parameters[0], nominal=0.023, std=0.004, assumed=True)])
  twin = SimpleNamespace(mechanisms=[mechanism], period=0.01, vehicle=SimpleNamespace(cg_height=0.04))
  (age,) = measured_figures(SimpleNamespace(free=free, values=np.array([0.024])), twin)
  assert age == Measured("encoder_latency", 0.0, usual.std, 0.024, 0.01, "s", usual=True)


def test_a_contradiction_is_in_the_verdict_and_in_the_table(clean_pool):
  nothing = diagnosis_of(clean_pool, (), "no_mismatch", holdout={}, validate={}, stages={})
  late = Departure("encoder_latency", 0.024, 0.0, 0.003, 8.0, "s", usual=True)
  apart = (Departure("mass", 3.8, 3.0, 0.01, 21.0, "kg"), late)
  told = dataclasses.replace(nothing, decision=dataclasses.replace(nothing.decision, departures=apart))
  said = (
    "The driving contradicts what was measured of the car: mass 3.8 kg, measured 3.000 ± 0.010 kg."
    " Unusual of such sensors: encoder latency 24 ms, usual 0.0 ± 3.0 ms."
  )
  assert said in verdict(told) and said not in verdict(nothing)
  claimed = SimpleNamespace(parameters={"encoder_latency": {}})  # a claim has said it
  assert departures_sentence(apart, [claimed]).strip() == said.split(" Unusual")[0]
  assert "mass: contradicts what was measured, by 21.0 deviations" in priors(told).text
  assert "contradicts what was measured, by" not in priors(nothing).text


def test_deviations_of_parameters_are_by_the_scatter_of_recordings(offset_pool):
  """As a claim's are: neighbouring samples share what disturbs them, and are no independent witnesses."""
  disturbed = dataclasses.replace(offset_pool.base, residual=offset_pool.base.residual.copy())
  recording = offset_pool.problem.observations.recording
  disturbed.residual += np.random.default_rng(0).normal(size=recording.max() + 1)[recording]
  pool = dataclasses.replace(offset_pool, models=offset_pool.models | {frozenset(): disturbed})
  (table,) = priors(diagnosis_of(pool, (), "no_mismatch")).tables
  told = {row[0]: row[3] for row in table.rows}
  scatter = dict(zip(disturbed.free.names, clustered_std(disturbed, pool.problem.observations), strict=True))
  for name, std in scatter.items():
    assert told[name] == spread(disturbed.estimate(name)[0], float(std))
  assert max(scatter[name] / disturbed.estimate(name)[1] for name in scatter) > 2.0
