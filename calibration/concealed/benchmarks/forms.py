"""How far the twin's own form moves what was measured of a car: figures fitted to sessions without any effect."""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from calibration.concealed.exam.session import make_exam_session
from calibration.concealed.proving_ground import make_session
from calibration.concealed.second_car import make_second_session
from calibration.diagnosis.decision.evidence import Measured
from calibration.diagnosis.pipeline import prepare
from calibration.diagnosis.pool import base_candidate
from calibration.diagnosis.search.gather import measured_figures
from qcar_twin.recordings.dataset import DataSet

_ONE_SIDED = 1.645  # standard errors: 95 %

CARS = {
  "first": lambda seed: make_session(seed, (), "compact"),
  "second": lambda seed: make_second_session(seed, (), "compact"),
  "slipx": lambda seed: make_exam_session("slipx", seed, bench=True),
}
"""Sessions without an effect, by generator and seed."""


def fitted_figures(cars: Sequence[str], seeds: Sequence[int]) -> Iterator[tuple[str, tuple[Measured, ...]]]:
  """The figures of every session as recalibration has them, with the generator."""
  for seed in seeds:
    for car in cars:
      session = CARS[car](seed)
      dataset = DataSet("session", session.recordings, session.vehicle, session.vehicle_std)
      recalibrated = prepare(dataset).recalibrated
      yield car, measured_figures(base_candidate(recalibrated), recalibrated.problem.twin)


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
