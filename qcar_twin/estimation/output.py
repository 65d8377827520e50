"""What an offline run of the filter leaves behind of each recording: estimates as CSV, a summary."""

from pathlib import Path

import numpy as np

from qcar_twin.atomic_io import write_text
from qcar_twin.estimation.offline import Estimates
from qcar_twin.recordings.recording import Recording


def write_estimates(folder: Path, recording: Recording, estimates: Estimates) -> dict[str, object]:
  """Write NAME.csv into a folder; returns a summary."""
  columns = estimates.columns()
  rows = np.column_stack(list(columns.values()))
  text = "\n".join([",".join(columns), *(",".join(f"{x:.7g}" for x in row) for row in rows)]) + "\n"
  write_text(folder / f"{recording.name}.csv", text)
  refused = {f"{channel}: {reason}": count for (channel, reason), count in estimates.refused.items()}
  share = float(np.mean(estimates.valid))
  return {"valid": share, "not valid because": dict(estimates.reasons), "refused": refused}
