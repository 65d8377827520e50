"""Twins fitted on to the recordings that had judged, once there is nothing left to judge.

Recordings of role "validate" choose between twins, so none may be fitted to them before that. Once the choice is made
they are driving like any other, often of a kind that the fitted recordings lack, and what predicts the car is fitted to
both. (Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, 2nd ed., 7.10: the model that was chosen
is fitted to all the data.) The hold-out stays closed.
"""

import dataclasses

from calibration.diagnosis.curves.flexible import Characterised
from calibration.diagnosis.curves.naming.bounds import with_room
from calibration.fitting.recalibration import RecalibratedTwin, reweighted, settled


def fitted_to_all(found: RecalibratedTwin) -> RecalibratedTwin:
  """The twin fitted from where it is to all its recordings; itself where none judged."""
  everything = len(found.problem.observations)
  if found.problem.n_train == everything:
    return found
  problem = reweighted(found).fitting(everything)
  return settled(problem, found.noise_models, found.fit.parameters, found.fit.theta, found.command_shift)


def finished(found: Characterised) -> Characterised:
  """A characterised twin, the same: see `fitted_to_all`."""
  return dataclasses.replace(found, fitted=with_room(fitted_to_all(found.fitted), found.forms))
