"""Estimates of a calibrated twin's parameters, with the deviations that recordings and the twin's form leave."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.optimiser import Fit
from calibration.intervals.clusters import fitted_std
from calibration.intervals.forms import OTHERS, size_of, usual_forms
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]
_UNSEEN = 0.5  # a prior deviation of a parameter moves all residuals together by less than this: nothing shows it
_OFF = 3.0  # prior deviations that are worth a word
NOT_SHOWN, HIDDEN = "no recording shows it", "larger errors of the twin hide it"


@dataclasses.dataclass(frozen=True)
class Estimate:
  """One parameter after calibration, in `unit`.

  Attributes:
    std: of the estimate about the car's own figure: disturbances that the recordings share (`Scatter`) and the twin's
      form (`calibration.intervals.forms`) together; 1.645 of it are meant to hold 90 %.
    noise_std: of independent noise alone, the posterior curvature's: by it two fits of one twin may differ.
    reason_not_fitted: why it was not fitted, or that nothing in the recordings shows it; "" for a fitted one.
  """

  value: float
  std: float
  noise_std: float
  unit: str
  prior: float
  prior_std: float
  at_bound: bool
  identifiable: bool
  reason_not_fitted: str = ""


def table_of(
  fitted: Fit,
  twin: Twin,
  every: ParameterSet,
  reason: str,
  group: NDArray[np.int64] | None,
  clear: Array | float = 1.0,
) -> dict[str, Any]:
  """Estimates of all parameters, ready for JSON; what no residual shows goes back to its prior.

  Where a channel is wrong by much more than its noise, its weight is that of the error: what would show but for that is
  hidden.

  Args:
    fitted: with its slopes.
    twin: that was fitted.
    every: parameters to tell of.
    reason: said of those that were not fitted.
    group: of every residual value, (M,): values of one group share disturbances; None where all are independent.
    clear: factors on the residuals, (M,), at which every channel weighs by its noise.
  """
  force, clear_force = _force(fitted, 1.0), _force(fitted, clear)
  std = fitted.std if group is None else fitted_std(fitted, group)
  table = {}
  for p in every:
    if p.name not in fitted.parameters:
      table[p.name] = _not_fitted(p.nominal, float(ParameterSet([p]).std[0]), p.unit, reason)
      continue
    i = fitted.parameters.index(p.name)
    row = fitted.table()[p.name]
    if force[i] < _UNSEEN:
      why = NOT_SHOWN if clear_force[i] < _UNSEEN else HIDDEN
      table[p.name] = _not_fitted(row["prior"], row["prior_std"], p.unit, why)
      continue
    form = form_deviation(p, float(fitted.theta[i]), twin)
    table[p.name] = {**row, "std": float(np.hypot(std[i], form)), "noise_std": row["std"]}
  return table


def _force(fitted: Fit, factor: Array | float) -> Array:
  """Size of what a prior deviation of each parameter moves all residuals by, times a factor, (p,)."""
  return np.sqrt(np.square(factor) * np.ones(len(fitted.jacobian)) @ np.square(fitted.jacobian)) * fitted.parameters.std


def form_deviation(parameter: Parameter, value: float, twin: Twin) -> float:
  """How far the twin's form moves a figure of the car, in its unit; 0 of what a sensor or a mechanism adds to it."""
  if parameter.null is not None:
    return 0.0
  forms, stated = usual_forms(), value if parameter.nominal else 0.0
  size = size_of(parameter.unit, stated, twin.period, twin.vehicle.cg_height)
  return forms.get(parameter.name, forms[OTHERS]) * size


def _not_fitted(prior: Any, std: Any, unit: str, reason: str) -> dict[str, Any]:
  return {"value": prior, "std": std, "noise_std": std, "unit": unit, "prior": prior, "prior_std": std,
          "at_bound": False, "identifiable": False, "reason_not_fitted": reason}  # fmt: skip


def estimate_of(row: Mapping[str, Any]) -> Estimate:
  """From a stored row, where an unknown number is null."""
  known: dict[str, Any] = {key: np.nan if value is None else value for key, value in row.items()}
  return Estimate(**known)


def judged(estimates: Mapping[str, Estimate]) -> list[str]:
  """Words on parameters at a bound, unseen, or far from what was measured."""
  why = {reason: [n for n, e in estimates.items() if e.reason_not_fitted == reason] for reason in (NOT_SHOWN, HIDDEN)}
  bound = [n for n, e in estimates.items() if e.at_bound]
  far = {
    n: (e.value - e.prior) / e.prior_std for n, e in estimates.items() if not e.reason_not_fitted and e.prior_std > 0
  }
  far = {n: share for n, share in far.items() if abs(share) > _OFF}
  notes = []
  if why[NOT_SHOWN]:
    notes.append(f"no recording shows {', '.join(why[NOT_SHOWN])}: left at the prior")
  if why[HIDDEN]:
    notes.append(
      f"larger errors of the twin hide {', '.join(why[HIDDEN])}: left at the prior; `qcar-twin diagnose` looks for what"
      " the twin lacks"
    )
  if bound:
    notes.append(f"at a bound of the fit: {', '.join(bound)}")
  if far:
    listed = ", ".join(f"{n} {share:+.1f}" for n, share in far.items())
    notes.append(f"far from the prior, in prior deviations: {listed}; something the twin lacks may hide here")
  return notes
