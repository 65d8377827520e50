"""What an offline run of the filter leaves behind: estimates as CSV, figures, a summary."""

from pathlib import Path

import numpy as np

from qcar_twin.atomic_io import write_text
from qcar_twin.estimation import figures
from qcar_twin.estimation.offline import Estimates
from qcar_twin.recordings.recording import Recording


def write_estimates(
  folder: Path, recording: Recording, estimates: Estimates, rolling_radius: float
) -> dict[str, object]:
  """Write NAME.csv, NAME_states.png and NAME_position.png; returns a summary.

  Args:
    folder: that exists.
    recording: that was filtered.
    rolling_radius: m of travel per rad of the motor, to draw the encoder as a speed.
  """
  columns = estimates.columns()
  rows = np.column_stack(list(columns.values()))
  text = "\n".join([",".join(columns), *(",".join(f"{x:.7g}" for x in row) for row in rows)]) + "\n"
  write_text(folder / f"{recording.name}.csv", text)
  figures.states_figure(estimates, recording, rolling_radius, folder / f"{recording.name}_states.png")
  figures.position_figure(estimates, recording, folder / f"{recording.name}_position.png")
  refused = {f"{channel}: {reason}": count for (channel, reason), count in estimates.refused.items()}
  share = float(np.mean(estimates.valid))
  return {"valid": share, "not valid because": dict(estimates.reasons), "refused": refused}
