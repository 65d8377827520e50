"""What characterising the cars of a wild campaign is worth, from its answers and truths alone."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.concealed.campaign.cases import Case
from calibration.concealed.campaign.intervals import exact_interval
from calibration.concealed.campaign.score import Result, truth_ids
from calibration.diagnosis.curves.driven import error_of
from calibration.diagnosis.curves.finish import fitted_to_all
from calibration.diagnosis.curves.flexible import characterise
from calibration.diagnosis.curves.naming.refits import Trials
from calibration.diagnosis.curves.naming.removals import matters, worth
from calibration.log_check.ready import ready
from qcar_twin import markdown
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.mechanisms import catalogue

TWINS = ("base", "curves", "characterised", "named", "shipped", "black_box")
_TRIM = "session_trim"  # of the generator: each half of the runs has a trim of its own, and their mean is not zero
# whose estimate is held against the generator's number, and by how much it may be off: absolute, share
AGES = {"encoder_latency": (0.01, 0.1), "imu_latency": (0.01, 0.1), "gyro_scale": (0.0, 0.1)}


def informed(dataset: DataSet, case: Case, threads: int = 1) -> dict[str, Any]:
  """The oracle: the twin with what is really there, as far as the catalogue has it.

  Returns:
    "known": what it was given; "holdout": its errors there by channel; "seen": effects it misses when they are taken
    away, by what driving it was not fitted to says. What it does as well without nobody can name.
  """
  checked, _ = ready(dataset)
  known = [name for name, _ in case.effects if name in catalogue()]
  fitted = characterise(checked, known, threads=threads)
  tests = worth(Trials.of(fitted), fitted.beside)
  return {
    "known": known,
    "holdout": error_of(fitted_to_all(fitted.fitted), checked.role("holdout")),
    "seen": [name for name in tests if matters(tests, name)],
  }


def names(answer: Mapping[str, Any]) -> set[str]:
  """What an answer says is there: forms of curves, be it nearly, effects that joined, and numbers that stand out."""
  owner = {p.name: m.name for m in catalogue().values() for p in m.parameters}
  beside = {owner[t["name"]] for t in answer["terms"] if t["there"] and t["name"] in owner}
  reported = [form for c in answer["curves"] if (form := c["named"] or c.get("nearly"))]
  forms = {name for form in reported for name in form["mechanisms"]}
  return beside | forms | {a["mechanism"] for a in answer["additions"]}


def shaped(answer: Mapping[str, Any]) -> set[str]:
  """Curves that an answer says depart, under whatever name."""
  return {c["curve"] for c in answer["curves"] if c["there"]}


def is_shaped(effect: str, answer: Mapping[str, Any]) -> bool:
  """Whether an effect is named, or the curve of its map is said to depart."""
  mechanism = catalogue().get(effect)
  if effect in names(answer):
    return True
  # effects that no form of a curve is declared for, though they act on its map
  maps = {"steering_map": "steering_curve", "drive_asymmetry": "drive_curve", "coulomb_friction": "resistance_curve"}
  return (maps.get(effect) or (mechanism.outlined_by if mechanism else "")) in shaped(answer)


def wild_table(results: Sequence[Result]) -> str:
  """Errors over the oracle's by channel, names with their intervals, and the cases, as Markdown."""
  listed = (markdown.table(columns, rows) for _, columns, rows in wild_tables(results))
  return "\n\n".join("\n".join(lines) for lines in listed) + "\n"


def wild_verdict(results: Sequence[Result]) -> str:
  """The outcome in one sentence."""
  if not results:
    return "No session has been answered yet."
  over = [_error(r, "shipped", c) / error for r in results for c, error in r["oracle"]["holdout"].items()]
  hits = dict(_counts(results))["names that are there"]
  return (
    f"The twins that are shipped err {np.median(over):.2f} times as much on the hold-out as the oracle, the median of"
    f" channels and cases; {sum(hits)} of {len(hits)} names that were claimed are there."
  )


def wild_tables(results: Sequence[Result]) -> list[tuple[str, tuple[str, ...], list[tuple[str, ...]]]]:
  """The same as title, columns and rows."""
  channels = list(dict.fromkeys(name for r in results for name in r["oracle"]["holdout"]))
  rows = []
  for kind in TWINS:
    ratios = {c: [_error(r, kind, c) / r["oracle"]["holdout"][c] for r in results if c in r["oracle"]["holdout"]]
              for c in channels}  # fmt: skip
    rows.append((kind.replace("_", " "), *(f"{np.median(ratios[c]):.2f}" for c in channels)))
  counted = [row for said, hits in _counts(results) if (row := _share(said, hits))]
  title = "hold-out error over the oracle's, median"
  return [
    ("Errors on the hold-out", (title, *channels), rows),
    ("Counts", ("counted", "cases", "share", "95 % interval"), counted),
    ("Cases", ("case", "truth", "names", "depart", "best"), [_case(r) for r in results]),
  ]


def _error(result: Result, kind: str, channel: str) -> float:
  """Of a kind of twin; "shipped" is the one that did best where recordings only judged."""
  answer = result["answer"]
  return answer["holdout"][answer["best"] if kind == "shipped" else kind][channel]


def _counts(results: Sequence[Result]) -> list[tuple[str, list[bool]]]:
  known = [(r, t["id"]) for r in results for t in r["truth"] if t["in_catalogue"]]
  seen = [(r, name) for r, name in known if name in r["oracle"].get("seen", ())]
  right = lambda r, name: name in truth_ids(r) or (name == "encoder_latency" and (r["sensors"] or {}).get("speed_late"))
  claimed = [(r, name) for r in results for name in sorted(names(r["answer"]))]
  trimmed = [r for r in results if _TRIM in truth_ids(r)]
  mean = lambda r, name: name == "steering_offset" and r in trimmed and _trims_reported(r)
  return [
    ("names that are there", [bool(right(r, name)) for r, name in claimed]),
    (
      "the same, the mean of sessions' trims counted as an offset",
      [bool(right(r, n)) or mean(r, n) for r, n in claimed],
    ),
    ("trims of sessions reported", [_trims_reported(r) for r in trimmed]),
    ("effects that the oracle sees, named", [name in names(r["answer"]) for r, name in seen]),
    ("effects that the oracle sees, named or shaped", [is_shaped(name, r["answer"]) for r, name in seen]),
    ("effects of the catalogue, named", [name in names(r["answer"]) for r, name in known]),
    ("effects of the catalogue, named or shaped", [is_shaped(name, r["answer"]) for r, name in known]),
    ("sensors' ages and scales within 10 ms or 10 %", [ok for r in results for ok in _ages(r)]),
  ]


def _trims_reported(result: Result) -> bool:
  """Whether an answer says that sessions differ in their trim."""
  return any(t["there"] and t["name"].startswith("steering_offset@") for t in result["answer"]["terms"])


def _ages(result: Result) -> list[bool]:
  """Of every age and scale that the generator states, whether the estimate is near it."""
  stated = {name: v for t in result["truth"] for name, v in (t.get("parameters") or {}).items() if name in AGES}
  stated |= {"encoder_latency": late} if (late := (result["sensors"] or {}).get("speed_late")) else {}
  reported = {t["name"]: t["value"] for t in result["answer"]["terms"]}
  near = lambda name, value: abs(reported[name] - value) <= max(AGES[name][0], AGES[name][1] * abs(value))
  return [near(name, value) for name, value in stated.items() if name in reported]


def _share(said: str, hits: Sequence[bool]) -> tuple[str, ...] | None:
  if not hits:
    return None
  low, high = exact_interval(sum(hits), len(hits))
  return said, f"{sum(hits)} of {len(hits)}", f"{np.mean(hits):.2f}", f"{low:.2f} to {high:.2f}"


def _case(result: Result) -> tuple[str, ...]:
  truth = ", ".join(f"{i} x {s:.2g}" for i, s in result["case"]["effects"])
  answer = result["answer"]
  listed = lambda which: ", ".join(sorted(which)) or "-"
  return result["case"]["name"], truth, listed(names(answer)), listed(shaped(answer)), answer["best"].replace("_", " ")
