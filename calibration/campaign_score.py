"""Scores of a campaign by a fixed rule, from its answers and truths alone."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qcar_twin.mechanisms import catalogue

Result = Mapping[str, Any]


def score(results: Sequence[Result]) -> dict[str, float | int | None]:
  """All figures of merit; None where a campaign has no case for one.

  A name counts as right if it is the first claim, or one the tool itself declares indistinguishable
  from its first claim on these recordings. Top three counts the ranking.
  """
  by = {kind: [r for r in results if r["case"]["kind"] == kind] for kind in ("null", "single", "pair", "outside")}
  singles = by["single"]
  typical = [r for r in singles if r["case"]["effects"][0][1] >= 0.99]
  small = [r for r in singles if r["case"]["effects"][0][1] < 0.99]
  return {
    "nulls": len(by["null"]),
    "nulls_with_claim": sum(bool(r["answer"]["claims"]) for r in by["null"]),
    "singles": len(singles),
    "ids": len({r["truth"][0]["id"] for r in singles}),
    "right_first": _mean(map(right_first, singles)),
    "right_first_typical": _mean(map(right_first, typical)),
    "right_first_third": _mean(map(right_first, small)),
    "right_or_declared_equivalent": _mean(map(right_or_equivalent, singles)),
    "top_three": _mean(map(in_top_three, singles)),
    "no_claim": _mean([not r["answer"]["claims"] for r in singles]),
    "wrong_first": _mean([bool(r["answer"]["claims"]) and not right_first(r) for r in singles]),
    "parameter_error_median": _median([e for r in singles if right_first(r) for e in parameter_errors(r)]),
    "subsystem": _mean(map(subsystem_right, singles)),
    "pairs": len(by["pair"]),
    "pairs_both": _mean([named(r) >= truth_ids(r) for r in by["pair"]]),
    "pairs_at_least_one": _mean([bool(named(r) & truth_ids(r)) for r in by["pair"]]),
    "pairs_nothing_false": _mean([named(r) <= truth_ids(r) for r in by["pair"]]),
    "outside": len(by["outside"]),
    "outside_unknown": _mean([r["answer"]["verdict"] in ("unexplained", "partly_explained") for r in by["outside"]]),
    "outside_sure_and_wrong": _mean(
      [any(c["probability"] > 0.8 for c in r["answer"]["claims"]) for r in by["outside"]]
    ),
    "recovered_median": _median([r["answer"]["recovered"] for r in [*singles, *by["pair"]] if r["answer"]["claims"]]),
    "channels_worse": _mean(map(any_channel_worse, [r for r in results if r["answer"]["claims"]])),
    "seconds_median": _median([r["answer"]["seconds"] for r in results]),
  }


def score_table(results: Sequence[Result]) -> str:
  """The score and the case list as Markdown."""
  lines = ["| figure | value |", "|---|---|"]
  for name, value in score(results).items():
    shown = "-" if value is None else (str(value) if isinstance(value, int) else f"{value:.3f}")
    lines.append(f"| {name.replace('_', ' ')} | {shown} |")
  lines += ["", "| case | seed | truth | verdict | claims | top three |", "|---|---|---|---|---|---|"]
  for r in sorted(results, key=lambda r: r["case"]["name"]):
    truth = ", ".join(f"{i} x {s:.2g}" for i, s in r["case"]["effects"]) or "nothing"
    claims = ", ".join(f"{c['mechanism']} ({c['probability']:.2f})" for c in r["answer"]["claims"]) or "-"
    top = ", ".join(x["mechanism"] for x in r["answer"]["ranking"][:3])
    lines.append(
      f"| {r['case']['name']} | {r['case']['seed']} | {truth} | {r['answer']['verdict']} | {claims} | {top} |"
    )
  return "\n".join(lines) + "\n"


def truth_ids(result: Result) -> set[str]:
  return {t["id"] for t in result["truth"]}


def named(result: Result) -> set[str]:
  return {c["mechanism"] for c in result["answer"]["claims"]}


def right_first(result: Result) -> bool:
  claims = result["answer"]["claims"]
  return bool(claims) and claims[0]["mechanism"] in truth_ids(result)


def right_or_equivalent(result: Result) -> bool:
  claims = result["answer"]["claims"]
  return bool(claims) and bool({claims[0]["mechanism"], *claims[0]["equivalent_to"]} & truth_ids(result))


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


def any_channel_worse(result: Result) -> bool:
  """Whether any hold-out channel is worse by more than 1 % after the repair."""
  return any(f["after"] > 1.01 * f["before"] for f in result["answer"]["fit"]["holdout"].values())


def _mean(values) -> float | None:
  found = [float(v) for v in values]
  return float(np.mean(found)) if found else None


def _median(values) -> float | None:
  found = [float(v) for v in values if v is not None]
  return float(np.median(found)) if found else None
