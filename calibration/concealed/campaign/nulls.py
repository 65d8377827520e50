"""What sessions without any effect let mechanisms reach by chance and by the twin's own simplifications."""

from collections.abc import Sequence

from calibration.concealed.campaign.score import Result
from qcar_twin import markdown

_T, _NATS = 1.8, 10.0  # what a trial must show to be listed


def spurious(results: Sequence[Result]) -> list[tuple[str, int, float, float, float]]:
  """Mechanisms that alone explained something on sessions without an effect; thresholds are to lie above them.

  Args:
    results: answered cases of a campaign; only its nulls count.

  Returns:
    (id, sessions, largest held-out nats, largest t, largest size as a share of typical), most nats first.
  """
  seen: dict[str, list[tuple[float, float, float]]] = {}
  for result in results:
    if result["case"]["kind"] != "null":
      continue
    for trial in result["answer"].get("trials", ()):
      if len(trial["set"]) == 1 and trial["t"] >= _T and trial["gain"] >= _NATS:
        size = max(abs(value) / typical for value, _, typical in trial["sizes"].values())
        seen.setdefault(trial["set"][0], []).append((trial["gain"], trial["t"], size))
  rows = [
    (name, len(strengths), *(max(column) for column in zip(*strengths, strict=True)))
    for name, strengths in seen.items()
  ]
  return sorted(rows, key=lambda row: -row[2])


def spurious_table(results: Sequence[Result]) -> str:
  """The same as Markdown."""
  titles = ("on sessions without an effect", "sessions", "nats, at most", "t, at most",
            "share of typical size, at most")  # fmt: skip
  rows = [(name, str(n), f"{nats:.0f}", f"{t:.1f}", f"{size:.2f}") for name, n, nats, t, size in spurious(results)]
  return "\n".join(markdown.table(titles, rows)) + "\n"
