"""What an answer of a campaign is measured against: the right mechanisms fitted to the same case, and simpler methods.

Both are made after the answer stands, from the pool the diagnosis leaves behind.
"""

import dataclasses
from collections.abc import Sequence

from calibration.concealed.campaign.reference_methods import run_baselines
from calibration.diagnosis.holdout_errors import compare_twins
from calibration.diagnosis.outcome import Outcome
from calibration.diagnosis.score import clustered_std, compare
from calibration.diagnosis.search.structure import ensure
from calibration.fitting.tolerances import sensor_error_mechanisms
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.mechanisms import catalogue


def oracle(outcome: Outcome, effects: Sequence[str], holdout: Sequence[Recording]) -> dict | None:
  """The twin with the mechanisms that are really there, as far as the catalogue has them; None where it has none.

  Returns:
    nats: drop of the cost it brings over the recalibrated twin; lost_without: of that, nats that are lost where one of
    them is left out; t, gain: held out; parameters: value and standard deviation; holdout: RMS error per channel in
    its unit.
  """
  known = frozenset(effects) & frozenset(catalogue())
  if not known:
    return None
  key, left = known - {m.name for m in sensor_error_mechanisms(catalogue().values())}, outcome.diagnosis.pool
  # what is fitted here nobody nominated: it must not join the models that other methods choose from
  pool = dataclasses.replace(left, models=dict(left.models))
  ensure(pool, [key, *(key - {name} for name in key)] if key else [])
  model = pool.models[key]
  test = compare(model, pool.base, pool.problem.observations)
  names = [p.name for name in known for p in pool.problem.mechanism(name).parameters if p.name in model.free]
  std = clustered_std(model, pool.problem.observations)
  fits = compare_twins(outcome.twin, pool.base.theta, model.theta, holdout, pool.floor, outcome.cut)[0]
  return {
    "nats": pool.base.cost - model.cost,
    "lost_without": {name: pool.models[key - {name}].cost - model.cost for name in sorted(key)},
    "t": test.t,
    "gain": test.gain,
    "parameters": {name: (model.value(name), float(std[model.free.index(name)])) for name in names},
    "holdout": {name: fit.after for name, fit in fits.items()},
  }


def baselines(outcome: Outcome, holdout: Sequence[Recording]) -> dict[str, dict]:
  """Answers of the simpler methods; of a ranking its first twelve."""
  answers = run_baselines(outcome.diagnosis.pool, holdout, outcome.cut)
  return {name: dataclasses.asdict(a) | {"ranking": a.ranking[:12]} for name, a in answers.items()}
