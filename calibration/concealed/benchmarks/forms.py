"""How far the twin's own form moves what was measured of a car: figures fitted to sessions without any effect."""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calibration.concealed.benchmarks.known import CARS, stated
from calibration.diagnosis.decision.evidence import Measured
from calibration.diagnosis.pipeline import prepare
from calibration.diagnosis.pool import base_candidate
from calibration.diagnosis.search.gather import measured_figures
from calibration.fitting.optimiser import with_jacobian
from calibration.fitting.recalibration import RecalibratedTwin
from calibration.intervals.clusters import fitted_std, groups_of
from qcar_twin.recordings.dataset import DataSet

Figures = tuple[str, tuple[Measured, ...], tuple[Measured, ...]]
_ONE_SIDED = 1.645  # standard errors: 95 %


def fitted_figures(cars: Sequence[str], seeds: Sequence[int]) -> Iterator[Figures]:
  """Figures of every session as recalibration has them.

  Yields:
    the generator; the figures that the vehicle states a deviation of, about what was measured; those that only the
    generator knows, about their truth and with the deviation of the fit.
  """
  for seed in seeds:
    for car in cars:
      session = CARS[car](seed)
      dataset = DataSet("session", session.recordings, session.vehicle, session.vehicle_std)
      recalibrated = prepare(dataset).recalibrated
      problem = recalibrated.problem
      figures = measured_figures(base_candidate(recalibrated), problem.twin, problem.observations)
      yield car, figures, _known(recalibrated, {} if car == "slipx" else stated(car, session.truth), figures)


def _known(
  recalibrated: RecalibratedTwin, truth: Mapping[str, float], measured: Sequence[Measured]
) -> tuple[Measured, ...]:
  """Figures of the twin that only the generator knows."""
  problem, fit = recalibrated.problem, recalibrated.fit
  slopes = with_jacobian(fit, recalibrated.jacobian[: problem.n_train], np.inf)
  std = fit.parameters.named(fitted_std(slopes, groups_of(problem.observations)[: problem.n_train]))
  values, left = fit.named(), set(truth) - {f.name for f in measured}
  return tuple(
    Measured(name, truth[name], std[name], values[name], truth[name], fit.parameters[name].unit)
    for name in sorted(left)
  )


def all_form_deviations(sessions: Sequence[Figures]) -> dict[str, tuple[float, int]]:
  """Form deviations of measured and of known figures; those that nobody looked at are of the kind of the measured."""
  known = form_deviations([(car, figures) for car, _, figures in sessions if figures])
  return {**known, **form_deviations([(car, figures) for car, figures, _ in sessions])}


def form_deviations(sessions: Sequence[tuple[str, Sequence[Measured]]]) -> dict[str, tuple[float, int]]:
  """Form deviation of each figure as a share of its size, with the number of sessions; "others" for all else.

  A figure's mean squared distance from what was measured, less the squared deviation of the measurement, is the square
  of its form deviation; every generator counts alike. Few sessions tell little, so it is the upper end of that mean's
  one-sided 95 % interval. That of a figure nobody looked at is their root mean square.
  """
  excess: dict[str, dict[str, list[float]]] = {}
  for car, figures in sessions:
    for f in figures:
      share = ((f.value - f.measured) ** 2 - f.std**2) / f.size**2
      excess.setdefault(f.name, {}).setdefault(car, []).append(share)
  shares = {name: (_deviation(by_car), sum(map(len, by_car.values()))) for name, by_car in sorted(excess.items())}
  usual = math.sqrt(float(np.mean([value**2 for value, _ in shares.values()])))
  return shares | {"others": (usual, len(sessions))}


def _deviation(by_car: Mapping[str, Sequence[float]]) -> float:
  rows = [np.array(values) for values in by_car.values()]
  variance = sum(float(np.var(r, ddof=1)) / len(r) for r in rows if len(r) > 1) / len(rows) ** 2
  upper = float(np.mean([r.mean() for r in rows])) + _ONE_SIDED * math.sqrt(variance)
  return math.sqrt(max(0.0, upper))
