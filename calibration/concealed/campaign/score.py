"""Scores of a campaign by a fixed rule, from its answers and truths alone."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from calibration.concealed.proving_ground.effects.base import effect_class
from calibration.diagnosis.decision.structure import PROPERTIES
from calibration.diagnosis.holdout_errors import share_removed
from qcar_twin import markdown
from qcar_twin.twin.mechanisms import catalogue

Result = Mapping[str, Any]
_KINDS = ("null", "single", "pair", "outside", "wild")
# nats the right mechanisms bring: what is below counts as no effect at all
LEVELS = {"easy": 1000.0, "medium": 150.0, "hard": 20.0, "invisible": -np.inf}

TYPICAL = 0.5  # of the typical size: a single effect below it is one of the small ones


def score(results: Sequence[Result]) -> dict[str, float | int | None]:
  """All figures of merit; None where a campaign has no case for one.

  A name counts as right if it is the first claim, or one the tool itself declares indistinguishable
  from its first claim on these recordings. Top three counts the ranking.
  """
  by = {kind: [r for r in results if r["case"]["kind"] == kind] for kind in _KINDS}
  singles = by["single"]
  typical = [r for r in singles if abs(r["case"]["effects"][0][1]) >= TYPICAL]
  small = [r for r in singles if abs(r["case"]["effects"][0][1]) < TYPICAL]
  visible = [r for r in singles if level(r) != "invisible"]
  claimed = [r for r in [*singles, *by["pair"]] if r["answer"]["claims"]]
  floor = null_floor(by["null"])
  return {
    "nulls": len(by["null"]),
    "nulls_with_claim": sum(bool(r["answer"]["claims"]) for r in by["null"]),
    "nulls_with_claim_share": mean([bool(r["answer"]["claims"]) for r in by["null"]]),
    "nulls_called_unexplained": sum(r["answer"]["verdict"] == "unexplained" for r in by["null"]),
    "singles": len(singles),
    "ids": len({r["truth"][0]["id"] for r in singles}),
    "right_first": mean(map(right_first, singles)),
    "right_first_typical": mean(map(right_first, typical)),
    "right_first_third": mean(map(right_first, small)),
    "right_or_declared_indistinguishable": mean(map(right_or_indistinguishable, singles)),
    "top_three": mean(map(in_top_three, singles)),
    "no_claim": mean([not r["answer"]["claims"] for r in singles]),
    "wrong_first": mean([bool(r["answer"]["claims"]) and not right_first(r) for r in singles]),
    "parameter_error_median": _median([e for r in singles if right_first(r) for e in parameter_errors(r)]),
    "subsystem": mean(map(subsystem_right, singles)),
    "pairs": len(by["pair"]),
    "pairs_both": mean([named(r) >= truth_ids(r) for r in by["pair"]]),
    "pairs_at_least_one": mean([bool(named(r) & truth_ids(r)) for r in by["pair"]]),
    "pairs_nothing_false": mean([named(r) <= truth_ids(r) for r in by["pair"]]),
    "outside": len(by["outside"]),
    "outside_unknown": mean(map(said_so, by["outside"])),
    "outside_right_variables": mean(map(right_variables, by["outside"])),
    "outside_sure_and_wrong": mean([any(c["probability"] > 0.8 for c in r["answer"]["claims"]) for r in by["outside"]]),
    **_wild(by["wild"]),
    "coverage_90": mean([inside for r in singles if right_first(r) for inside in parameters_inside(r)]),
    "right_first_easy": mean([right_first(r) for r in singles if level(r) == "easy"]),
    "right_first_medium": mean([right_first(r) for r in singles if level(r) == "medium"]),
    "right_first_hard": mean([right_first(r) for r in singles if level(r) == "hard"]),
    "right_first_visible": mean(map(right_first, visible)),
    "top_three_visible": mean(map(in_top_three, visible)),
    "subsystem_visible": mean(map(subsystem_right, visible)),
    "as_good_as_invisible": sum(level(r) == "invisible" for r in singles),
    "recovered_over_sensor_noise": _median([recovered(r, sensor_noise(r)) for r in claimed]),
    "recovered_over_nulls": _median([recovered(r, floor) for r in claimed]),
    "recovered_over_oracle": _median([recovered(r, r["oracle"]["holdout"]) for r in claimed if r.get("oracle")]),
    "error_over_oracle_median": _median([error_over(r, r["oracle"]["holdout"]) for r in claimed if r.get("oracle")]),
    "channels_worse": mean(map(any_channel_worse, [r for r in results if r["answer"]["claims"]])),
    "channels_worse_of_all_cases": mean(map(any_channel_worse, results)),
    "channels_worse_beyond_chance": mean(map(any_channel_surely_worse, results)),
    "calibration_error": expected_error(stated_claims(results)),
    "seconds_median": _median([r["answer"]["seconds"] for r in results]),
  }


def _wild(results: Sequence[Result]) -> dict[str, float | int | None]:
  """Of cars with many effects: names claimed that are there, effects of the catalogue that are named."""
  return {
    "wild": len(results),
    "wild_names_there": mean([name in truth_ids(r) for r in results for name in named(r)]),
    "wild_effects_named": mean([t["id"] in named(r) for r in results for t in r["truth"] if t["in_catalogue"]]),
    "wild_error_over_oracle_median": _median(
      [error_over(r, r["oracle"]["holdout"]) for r in results if r.get("oracle")]
    ),
  }


def score_baselines(results: Sequence[Result]) -> dict[str, dict[str, float | int | None]]:
  """The diagnosis and each simpler method on the same cases.

  Returns:
    method -> nulls_with_claim; right_first and wrong_first, shares of the singles; holdout_error_median: error on
    hold-outs over that of the recalibrated twin, over singles and pairs; None where a method does not answer.
  """
  methods = {m: {} for r in results for m in r.get("baselines", ())}
  nulls, singles = ([r for r in results if r["case"]["kind"] == kind] for kind in ("null", "single"))
  effects = [r for r in results if r["case"]["kind"] in ("single", "pair")]
  for method in methods:
    answered = lambda r, m=method: r["baselines"][m]
    names = any(answered(r)["claims"] or answered(r)["ranking"] for r in results)
    methods[method] = {
      "nulls_with_claim": sum(bool(answered(r)["claims"]) for r in nulls) if names else None,
      "right_first": mean([answered(r)["claims"][:1] == [r["truth"][0]["id"]] for r in singles]) if names else None,
      "wrong_first": mean(
        [bool(answered(r)["claims"]) and answered(r)["claims"][0] != r["truth"][0]["id"] for r in singles]
      )
      if names
      else None,
      "holdout_error_median": _median([_error_ratio(r, answered(r)["holdout"]) for r in effects]),
    }
  ours = {
    "nulls_with_claim": sum(bool(r["answer"]["claims"]) for r in nulls),
    "right_first": mean(map(right_first, singles)),
    "wrong_first": mean([bool(r["answer"]["claims"]) and not right_first(r) for r in singles]),
    "holdout_error_median": _median(
      [_error_ratio(r, {n: f["after"] for n, f in r["answer"]["fit"]["holdout"].items()}) for r in effects]
    ),
  }
  return {"diagnosis": ours} | methods


def _error_ratio(result: Result, errors: Mapping[str, float]) -> float | None:
  """Root mean square over the channels of error / error of the recalibrated twin; None without errors."""
  fits = result["answer"]["fit"]["holdout"]
  ratios = [errors[n] / fits[n]["before"] for n in fits if n in errors]
  return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None


def score_table(results: Sequence[Result]) -> str:
  """The score and the case list as Markdown."""
  figures = [(name.replace("_", " "), _shown(value)) for name, value in score(results).items()]
  methods = [
    (name.replace("_", " "), *("-" if v is None else f"{v:.3g}" for v in row.values()))
    for name, row in score_baselines(results).items()
  ]
  bins = [
    (f"{low:g} to {high:g}", str(count), *("-" if v is None else f"{v:.2f}" for v in (stated, right)))
    for low, high, count, stated, right in reliability(stated_claims(results))
  ]
  cases = [case_row(r) for r in sorted(results, key=lambda r: r["case"]["name"])]
  tables = (
    markdown.table(("figure", "value"), figures),
    markdown.table(("method", "nulls with a claim", "right name", "wrong name", "hold-out error, median"), methods),
    markdown.table(("stated probability of a claim", "claims", "mean probability", "share right"), bins),
    markdown.table(("case", "seed", "truth", "verdict", "claims", "top three"), cases),
  )
  return "\n\n".join("\n".join(lines) for lines in tables) + "\n"


def _shown(value: float | int | None) -> str:
  return "-" if value is None else (str(value) if isinstance(value, int) else f"{value:.3f}")


def case_row(result: Result) -> tuple[str, ...]:
  """Name, seed, truth, verdict, claims, and the first three of the ranking."""
  case, answer = result["case"], result["answer"]
  truth = ", ".join(f"{i} x {s:.2g}" for i, s in case["effects"]) or "nothing"
  claims = ", ".join(f"{c['mechanism']} ({c['probability']:.2f})" for c in answer["claims"]) or "-"
  top = ", ".join(x["mechanism"] for x in answer["ranking"][:3])
  return case["name"], str(case["seed"]), truth, answer["verdict"], claims, top


def reliability(stated: Sequence[tuple[float, bool]]) -> list[tuple[float, float, int, float | None, float | None]]:
  """What probabilities are worth, per bin: lower and upper end, claims, their mean probability, share right.

  Args:
    stated: of each claim its probability, and whether it is right.
  """
  edges = (0.0, 0.5, 0.8, 0.95, 1.0)
  rows = []
  for low, high in zip(edges[:-1], edges[1:], strict=True):
    inside = [(p, right) for p, right in stated if low <= p < high or (high == p == 1.0)]
    rows.append((low, high, len(inside), mean(p for p, _ in inside), mean(right for _, right in inside)))
  return rows


def expected_error(stated: Sequence[tuple[float, bool]]) -> float | None:
  """Expected calibration error: |mean stated probability - share right| over the bins, weighted by their claims."""
  bins = [(count, abs(said - right)) for *_, count, said, right in reliability(stated) if count]  # type: ignore[operator]
  return float(np.average([off for _, off in bins], weights=[count for count, _ in bins])) if bins else None


def stated_claims(results: Sequence[Result]) -> list[tuple[float, bool]]:
  """Of each claim of answers its probability, and whether it is right."""
  return [(c["probability"], c["mechanism"] in truth_ids(r)) for r in results for c in r["answer"]["claims"]]


def truth_ids(result: Result) -> set[str]:
  return {t["id"] for t in result["truth"]}


def named(result: Result) -> set[str]:
  return {c["mechanism"] for c in result["answer"]["claims"]}


def right_first(result: Result) -> bool:
  claims = result["answer"]["claims"]
  return bool(claims) and claims[0]["mechanism"] in truth_ids(result)


def right_or_indistinguishable(result: Result) -> bool:
  claims = result["answer"]["claims"]
  return bool(claims) and bool({claims[0]["mechanism"], *claims[0]["indistinguishable_from"]} & truth_ids(result))


def in_top_three(result: Result) -> bool:
  return bool({x["mechanism"] for x in result["answer"]["ranking"][:3]} & truth_ids(result))


def subsystem_right(result: Result) -> bool:
  known = catalogue()
  return result["answer"]["where"]["subsystem"] in {known[i].subsystem for i in truth_ids(result) if i in known}


def parameter_errors(result: Result) -> list[float]:
  """Relative errors of the claimed amplitudes that the generator states in the same parameter."""
  claim = result["answer"]["claims"][0]
  stated = {k: v for t in result["truth"] for k, v in (t.get("parameters") or {}).items()}
  return [
    abs(claim["parameters"][name]["value"] - value) / abs(value)
    for name, value in stated.items()
    if name in claim["parameters"] and value
  ]


def parameters_inside(result: Result) -> list[bool]:
  """Whether each amplitude that the generator states in the same parameter lies in the claim's 90 % interval."""
  claim = result["answer"]["claims"][0]["parameters"]
  stated = {k: v for t in result["truth"] for k, v in (t.get("parameters") or {}).items()}
  return [abs(claim[k]["value"] - v) <= 1.645 * claim[k]["std"] for k, v in stated.items() if k in claim and v]


def level(result: Result) -> str:
  """How hard a case is, by what the right model brings over the recalibrated twin: see LEVELS."""
  nats = (result.get("oracle") or {}).get("nats", 0.0)
  return next(name for name, least in LEVELS.items() if nats >= least)


def null_floor(nulls: Sequence[Result]) -> dict[str, float]:
  """Median hold-out error per channel of recalibrated twins on sessions without effects at the usual noise."""
  usual = [r["answer"]["fit"]["holdout"] for r in nulls if r["case"]["noise"] == 1.0]
  return {
    name: float(np.median([fit[name]["before"] for fit in usual if name in fit]))
    for name in (usual[0] if usual else ())
  }


def sensor_noise(result: Result) -> dict[str, float]:
  """What the sensors alone make of the hold-out error per channel: while driving where the answer has it."""
  fits = result["answer"]["fit"]["holdout"]
  return {name: max(f["noise_floor"], f.get("driving_noise") or 0.0) for name, f in fits.items() if f["noise_floor"]}


def recovered(result: Result, floor: Mapping[str, float]) -> float | None:
  """Share of the squared hold-out error above a floor that the repair took away, see `share_removed`.

  None where the errors before hardly exceed the floor (by less than a tenth of their squares on average): there is
  nothing to recover.
  """
  fits = {n: f for n, f in result["answer"]["fit"]["holdout"].items() if floor.get(n)}
  if np.sum([1.0 - (floor[n] / f["before"]) ** 2 for n, f in fits.items()]) <= 0.1 * len(fits):
    return None
  before, after = ({n: f[key] for n, f in fits.items()} for key in ("before", "after"))
  return share_removed(before, after, floor)


def error_over(result: Result, reference: Mapping[str, float]) -> float:
  """Hold-out error over that of a reference, root mean square over the channels."""
  fits = result["answer"]["fit"]["holdout"]
  return float(np.sqrt(np.mean([(fits[n]["after"] / reference[n]) ** 2 for n in fits if reference.get(n)])))


def any_channel_worse(result: Result) -> bool:
  """Whether any hold-out channel is worse by more than 1 % after the repair."""
  return any(f["after"] > 1.01 * f["before"] for f in result["answer"]["fit"]["holdout"].values())


def worse_than_right_model(result: Result) -> bool:
  """Whether any hold-out channel is worse by more than 1 % after the repair, and than with the right model."""
  right = (result.get("oracle") or {}).get("holdout", {})
  fits = result["answer"]["fit"]["holdout"]
  return any(f["after"] > 1.01 * max(f["before"], right.get(name, 0.0)) for name, f in fits.items())


def both_seen(result: Result) -> bool:
  """Whether the right model loses the nats of a visible effect by leaving any one of its mechanisms out."""
  lost = (result.get("oracle") or {}).get("lost_without", {})
  return bool(lost) and min(lost.values()) >= LEVELS["hard"]


def said_so(result: Result) -> bool:
  """Whether the verdict says that something nameless acts."""
  return result["answer"]["verdict"] in ("unexplained", "partly_explained")


def right_variables(result: Result) -> bool:
  """Whether the strongest property of a nameless effect is one that its formula is a function of."""
  properties = {PROPERTIES[f] for t in result["truth"] for f in getattr(effect_class(t["id"]), "carried_by", ())}
  return bool(properties & set(((result["answer"].get("unknown") or {}).get("properties") or [])[:1]))


def any_channel_surely_worse(result: Result) -> bool:
  """The same, and the change's 95 % interval lies above nothing: a channel at its sensor's noise moves by chance."""
  fits = result["answer"]["fit"]["holdout"].values()
  return any(f["after"] > 1.01 * f["before"] and f["ci95"][0] > 0.0 for f in fits)


def mean(values: Iterable[float]) -> float | None:
  """Of numbers or of what is true or false; None of none."""
  numbers = [float(v) for v in values]
  return float(np.mean(numbers)) if numbers else None


def _median(values) -> float | None:
  numbers = [float(v) for v in values if v is not None]
  return float(np.median(numbers)) if numbers else None
