"""Campaigns on the proving ground: many sessions with concealed effects, diagnosed blind and scored.

A case is made from its seed, diagnosed without sight of its truth, and its answer is written with its
hash before the truth is looked at. A campaign that is stopped goes on where it was.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.campaign_archive import digest, keep
from calibration.campaign_reference import baselines, oracle
from calibration.diagnosis.diagnose import Outcome, diagnose
from calibration.diagnosis.output import document
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import Comparison, compare
from calibration.diagnosis.ship import recovered_share
from calibration.proving_ground import make_session
from calibration.proving_ground.effects import EFFECTS
from qcar_twin.dataset import DataSet
from qcar_twin.mechanisms import catalogue


@dataclasses.dataclass(frozen=True)
class Case:
  """One session of a campaign: effects as (id, size in multiples of typical)."""

  name: str
  kind: str  # null, single, pair, outside
  seed: int
  effects: tuple[tuple[str, float], ...]
  noise: float
  design: str = "compact"


def draw_cases(seed: int, nulls: int, singles: int, pairs: int, outside: int, design: str = "compact") -> list[Case]:
  """Cases of a campaign, all decided by one seed.

  Nulls take turns with three noise levels. Singles go through the catalogue in a drawn order, at the
  typical size and at a third of it in turn. Pairs combine two subsystems at the typical size.
  """
  rng = np.random.default_rng(seed)
  known = sorted(set(catalogue()) & set(EFFECTS))
  foreign = sorted(set(EFFECTS) - set(known))
  first = int(rng.integers(10**6, 10**8))
  cases = [
    Case(f"null_{i:02d}", "null", first + i, (), (0.5, 1.0, 2.0)[i % 3], design)
    for i in range(nulls)
  ]  # fmt: skip
  order = [known[i] for i in rng.permutation(len(known))]
  for i in range(singles):
    effect = order[i % len(order)]
    cases.append(Case(f"single_{i:02d}", "single", first + 1000 + i, ((effect, (1.0, 1 / 3)[i % 2]),), 1.0, design))
  for i in range(pairs):
    cases.append(Case(f"pair_{i:02d}", "pair", first + 2000 + i, _pair(rng, known), 1.0, design))
  for i, k in enumerate(rng.permutation(len(foreign))[:outside]):
    cases.append(Case(f"outside_{i:02d}", "outside", first + 3000 + i, ((foreign[k], 1.0),), 1.0, design))
  return cases


def _pair(rng: np.random.Generator, known: Sequence[str]) -> tuple[tuple[str, float], ...]:
  found = catalogue()
  while True:
    one, other = (known[int(i)] for i in rng.permutation(len(known))[:2])
    if found[one].subsystem != found[other].subsystem:
      return (one, 1.0), (other, 1.0)


def run_case(case: Case, folder: Path, threads: int = 1) -> Path:
  """Make, diagnose and answer one case; does nothing if its answer is there."""
  path = folder / f"{case.name}.json"
  if path.is_file():
    return path
  session = make_session(case.seed, case.effects, case.design, case.noise)
  dataset = DataSet(case.name, session.recordings, session.vehicle, session.vehicle_std)
  outcome = diagnose(dataset, threads=threads)
  answer = _answer(outcome)
  sealed = digest(answer)
  # the truth joins the file only after the answer and its hash stand
  truth, holdout = session.truth["effects"], dataset.role("holdout")
  result = {"case": dataclasses.asdict(case), "answer": answer, "sha256": sealed, "truth": truth}
  result |= {"oracle": oracle(outcome, [t["id"] for t in truth], holdout), "baselines": baselines(outcome, holdout)}
  folder.mkdir(parents=True, exist_ok=True)
  keep(result, path)
  return path


def _answer(outcome: Outcome) -> dict:
  """What the diagnosis says, and the figures a threshold can be learnt from."""
  found = outcome.diagnosis
  full = document(found)
  keep = ("verdict", "claims", "where", "untestable", "fit", "seconds", "unknown")
  out = {key: full[key] for key in keep} | {"ranking": full["ranking"][:12]}
  out["stages"] = dict(found.stages)
  out["tests"] = [{"mechanism": c.mechanism} | _figures(c.held_out) for c in found.decision.claims]
  out["possible"] = list(found.decision.possible)
  rival = found.decision.unknown
  out["rival"] = None if rival is None else {"name": rival[0]} | _figures(rival[1])
  out["trials"] = _trials(found.pool)
  out["recovered"] = recovered_share(found.holdout) if found.holdout else None
  out["alarms"] = [d.name for d in found.detection.detectors if d.alarm]
  out["statistics"] = {d.name: d.statistic for d in found.detection.detectors}
  return out


def _trials(pool: Pool) -> list[dict]:
  """Every set that was fitted, with its figures: what thresholds are learnt from."""
  rows = []
  for key, model in pool.models.items():
    if not key:
      continue
    sizes = {
      p.name: [*model.estimate(p.name), p.typical or p.scale]
      for name in key
      for p in pool.problem.mechanism(name).parameters
      if p.null is not None
    }
    test = compare(model, pool.base, pool.problem.observations)
    rows.append({"set": sorted(key), "cost": pool.base.cost - model.cost, "sizes": sizes} | _figures(test))
  return sorted(rows, key=lambda r: -r["total"])


def _figures(test: Comparison) -> dict[str, float]:
  return {
    "t": test.t,
    "gain": test.gain,
    "share": test.share_positive,
    "total": test.total,
    "relative": test.relative,
  }
