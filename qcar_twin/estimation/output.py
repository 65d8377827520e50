"""What an offline run of the filter leaves behind of each recording: estimates as CSV, a summary."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from qcar_twin.atomic_io import write_json, write_text
from qcar_twin.estimation.offline import Estimates
from qcar_twin.recordings.recording import Recording


def write_all(folder: Path, filtered: Sequence[tuple[Recording, Estimates]]) -> None:
  """Write NAME.csv of every recording and summary.json into a folder."""
  write_json(folder / "summary.json", {r.name: write_estimates(folder, r, estimates) for r, estimates in filtered})


def write_estimates(folder: Path, recording: Recording, estimates: Estimates) -> dict[str, object]:
  """Write NAME.csv into a folder, on the log's own clock and in its own frame, each number as it is; returns a summary.

  The filter works on time and place counted from the recording's origin; doubles resolve a date's clock to 0.2 us.
  """
  columns = estimates.columns()
  for name, taken in zip(("time", "pose_x", "pose_y"), recording.origin, strict=True):
    columns[name] = columns[name] + taken
  rows = np.column_stack(list(columns.values())).tolist()
  text = "\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)]) + "\n"
  write_text(folder / f"{recording.name}.csv", text)
  refused = {f"{channel}: {reason}": count for (channel, reason), count in estimates.refused.items()}
  share = float(np.mean(estimates.valid))
  numbers = {
    name: dict(zip(("value", "std"), known[-1].tolist(), strict=True)) for name, known in estimates.numbers.items()
  }
  told = {"valid": share, "not valid because": dict(estimates.reasons), "refused": refused}
  return told | ({"numbers": numbers} if numbers else {})
