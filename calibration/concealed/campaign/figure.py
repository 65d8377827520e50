"""Which effect was taken for which: the first claims of a campaign against the truth, as a table and a picture."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.concealed.campaign.score import Result
from qcar_twin.plotting import new_figure, save


def confusion_table(results: Sequence[Result]) -> tuple[list[str], list[str], NDArray[np.int64]]:
  """Truths (rows), first claims (columns), how often they met; pairs count with their first effect that was claimed."""
  pairs = [(_truth(r), _answer(r)) for r in results]
  truths = sorted({t for t, _ in pairs}, key=lambda name: (name == "nothing", name))
  answers = sorted({a for _, a in pairs}, key=lambda name: (name == "no claim", name not in truths, name))
  table = np.zeros((len(truths), len(answers)), dtype=np.int64)
  for truth, answer in pairs:
    table[truths.index(truth), answers.index(answer)] += 1
  return truths, answers, table


def draw_confusion(results: Sequence[Result], path: str | Path) -> None:
  """Write the table as a picture."""
  truths, answers, table = confusion_table(results)
  canvas, ((axes,),) = new_figure(1, 1, width=0.17 * len(answers) + 2.2, row_height=0.15 * len(truths) + 1.8)
  axes.imshow(table, cmap="Blues", vmax=max(2, table[:-1].max(initial=1)), aspect="auto")
  for (row, column), count in np.ndenumerate(table):
    if count:
      right = truths[row] == answers[column] or (truths[row], answers[column]) == ("nothing", "no claim")
      axes.text(column, row, str(count), ha="center", va="center", fontsize=6, color="white" if right else "firebrick")
  axes.set_xticks(range(len(answers)), answers, rotation=90, fontsize=6)
  axes.set_yticks(range(len(truths)), truths, fontsize=6)
  axes.set_xlabel("first claim")
  axes.set_ylabel("truth")
  axes.grid(False)
  save(canvas, path, dpi=140)


def _truth(result: Result) -> str:
  ids = [t["id"] for t in result["truth"]]
  said = [c["mechanism"] for c in result["answer"]["claims"]]
  return next((i for i in said if i in ids), ids[0] if ids else "nothing")


def _answer(result: Result) -> str:
  claims = result["answer"]["claims"]
  return claims[0]["mechanism"] if claims else "no claim"
