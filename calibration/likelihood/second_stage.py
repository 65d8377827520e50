"""The calibration that is shipped: the claimed names fitted in free runs, as every calibration is.

What is likely over a tenth of a second need not run free for six: names and sizes come from the likelihood, the twin's
parameters from stretches of driving.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.dataset_recalibration import recalibrate_dataset
from calibration.fitting.surrogate import searching
from calibration.likelihood.hypotheses import Option
from calibration.likelihood.refit import Minimum
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]


def calibrated(twin: Twin, dataset: DataSet) -> Array:
  """Parameters (P,) of a twin in MuJoCo without a name, fitted in free runs."""
  return recalibrate_dataset(dataset, searching(twin)[0]).theta


def calibrated_with(twin: Twin, dataset: DataSet, names: Sequence[Option], at: Minimum) -> Array:
  """The same with names, from where the likelihood found them, (P,)."""
  values = dict(zip(at.free.names, at.values, strict=True))
  added = [dataclasses.replace(p, nominal=float(values[p.name])) for o in names for p in (*o.amplitudes, *o.shapes)]
  return recalibrate_dataset(dataset, searching(twin)[0], added=added).theta
