"""What came of the trials, counted by a fixed rule, as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from qcar_twin import markdown

from ..campaign.intervals import exact_interval

SURE = 20.0  # nats from which an injection ought to be found
CLOSE = 0.2  # of a size that came back

Trial = Mapping[str, Any]


def counts(trials: Sequence[Trial]) -> list[tuple[str, int, int]]:
  """(what was counted, how often, of how many)."""
  splits = [t for t in trials if "effect" not in t and "refused" not in t]
  put = [t for t in trials if "effect" in t]
  judged = [t for t in put if "refused" not in t]
  large = [t for t in judged if (t["nats"] or 0.0) >= SURE]
  named = [t for t in large if first_is_right(t)]
  rows = [
    ("halves between which nothing was changed: something is said to differ", splits, lambda t: bool(t["moved"])),
    (f"injections of {SURE:g} nats and more: something is said to differ", large, lambda t: bool(t["moved"])),
    ("of those: the surest difference has the right name", large, first_is_right),
    ("of those: a right name is among the differences", large, right_is_there),
    (f"of those with the right name first: size within {CLOSE:.0%}", named, size_is_close),
    ("injections of fewer nats: something is said to differ", [t for t in judged if t["nats"] and t["nats"] < SURE],
     lambda t: bool(t["moved"])),
    ("of all that are said to differ: a wrong name first", [t for t in judged if t["moved"]],
     lambda t: not first_is_right(t)),
    ("injections that the check of the log refuses to compare", put, lambda t: "refused" in t),
  ]  # fmt: skip
  return [(said, sum(map(test, chosen)), len(chosen)) for said, chosen, test in rows if chosen]


def first_is_right(trial: Trial) -> bool:
  return bool(trial["moved"]) and trial["moved"][0]["name"] in trial["right"]


def right_is_there(trial: Trial) -> bool:
  return any(m["name"] in trial["right"] for m in trial["moved"])


def size_is_close(trial: Trial) -> bool:
  return trial["back"] is not None and abs(trial["back"] / trial["size"] - 1.0) <= CLOSE


def page(name: str, trials: Sequence[Trial], command: str) -> str:
  """The Markdown page."""
  lines = [f"# Real recordings: {name}", "", f"`{command}`", ""]
  rows = [
    (said, f"{hits} of {of}", "{:.2f} to {:.2f}".format(*exact_interval(hits, of))) for said, hits, of in counts(trials)
  ]
  lines += [*markdown.table(("counted", "trials", "95 % interval"), rows), ""]
  shown = [injection_row(t) for t in trials if "effect" in t]
  if shown:
    heads = ("injected", "size", "nats", "came back", "said to differ, surest first")
    lines += ["## Injections", "", *markdown.table(heads, shown), ""]
  rows = [(t["trial"], _differences(t)) for t in trials if "effect" not in t]
  if rows:
    lines += ["## Halves", "", *markdown.table(("halves", "said to differ"), rows), ""]
  return "\n".join(lines)


def injection_row(trial: Trial) -> tuple[str, ...]:
  size = f"{trial['size']:.3g} {trial['unit']}"
  nats = "-" if trial["nats"] is None else f"{trial['nats']:.0f}"
  back = trial.get("back")
  told = "-" if back is None else f"{back:.3g} ± {trial['back_std']:.1g}"
  return trial["effect"], size, nats, told, _differences(trial)


def _differences(trial: Trial) -> str:
  if "refused" in trial:
    return f"refused: {trial['refused'][:120]}"
  names = [m["name"] for m in trial["moved"]]
  more = f" and {len(names) - 4} more" if len(names) > 4 else ""
  return (", ".join(names[:4]) or "nothing") + more
