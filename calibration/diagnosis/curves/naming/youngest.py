"""The youngest sensor is the clock: nothing is read before it happens.

Ages are fitted against one sensor, the pose where there is one. Where another seems to speak before it, the pose is
late, by as much, and commands act so much sooner than they seem to.
"""

import dataclasses

import numpy as np

from calibration.diagnosis.candidates import refine, simulate
from calibration.diagnosis.curves.flexible import AGES, DELAYS
from calibration.diagnosis.curves.naming.refits import Trials
from qcar_twin.parameters import Parameter, ParameterSet

_STEPS = 2  # of Gauss-Newton: the same twin in other words is at its minimum already, nearly


def by_the_youngest(trials: Trials) -> Trials:
  """The twin with ages counted from its youngest sensor, fitted anew from there; itself where that is its clock."""
  base = trials.base
  ages = {name: base.value(name) for name in AGES if name in base.free}
  youngest = min(ages, key=lambda name: ages[name], default="")
  if not youngest or ages[youngest] >= 0.0:
    return trials
  late = -ages[youngest]
  start = {name: age + late for name, age in ages.items()} | {trials.clock: late}
  start |= {name: max(base.value(name) - late, 0.0) for name in DELAYS if name in base.free}
  model = trials.model((trials.clock,), start, without={youngest})
  model.free = _counted_from(base.free[youngest], model.free, trials.clock)
  simulate(trials.problem, [model])
  refine(trials.problem, [model], _STEPS, full=True)
  beside = tuple(name for name in (*trials.beside, trials.clock) if name != youngest)
  return dataclasses.replace(trials, base=model, beside=beside, clock=youngest)


def _counted_from(youngest: Parameter, free: ParameterSet, clock: str) -> ParameterSet:
  """Priors of ages against another sensor, and none below zero."""
  unsure = float(ParameterSet([youngest]).std[0])
  known = {clock: (-youngest.nominal, unsure)}
  for name, std in zip(free.names, free.std.tolist(), strict=True):
    if name in AGES and name != clock:
      known[name] = free[name].nominal - youngest.nominal, float(np.hypot(std, unsure))
  return ParameterSet(
    dataclasses.replace(p, nominal=max(known[p.name][0], 0.0), std=known[p.name][1], lower=0.0)
    if p.name in known
    else p
    for p in free
  )
