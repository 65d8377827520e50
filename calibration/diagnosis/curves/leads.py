"""By how much commands act before they are logged.

Commands that are logged rarely are moved earlier by the whole interval between two of them, since a change may have
acted up to so long before the sample that shows it; delays, which cannot be negative, are sought from there.
"""

from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.recording import Recording

PERIOD = 0.01  # s, of the twin's control


def command_interval(recordings: Sequence[Recording]) -> float:
  """Longest usual time between two logged commands, s."""
  streams = [r[name] for r in recordings for name in (r.drive_channel, "steering_command") if name in r]
  return max(float(np.median(np.diff(s.time))) for s in streams if len(s.time) > 1)


def command_lead(recordings: Sequence[Recording]) -> int:
  """Control periods by which commands are moved earlier; none where they are logged as often as they act."""
  periods = int(round(command_interval(recordings) / PERIOD))
  return periods if periods > 1 else 0
