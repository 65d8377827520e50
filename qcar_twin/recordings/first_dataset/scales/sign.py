"""Speeds that lost the sign of driving backwards."""

from collections.abc import Mapping, Sequence

from qcar_twin.recordings.channels import DRIVE_COMMANDS
from qcar_twin.recordings.checks.acted import against, lost_sign
from qcar_twin.recordings.first_dataset.columns import Columns, Guess
from qcar_twin.recordings.recording import Recording

UNSIGNED = 0.02  # of the largest value: what noise about zero may be below it


def settle_sign(columns: Columns, guesses: Mapping[str, Guess], recordings: Sequence[Recording]) -> None:
  """A speed without a sign, of a car that drives on under negative commands, gets that of the command."""
  drive = next((name for name in DRIVE_COMMANDS if name in guesses), None)
  speeds = [guesses[name] for name in ("motor_speed", "speed") if name in guesses]
  if not drive or any(g.gate or g.signed_by for g in speeds) or not _backs_at_times(recordings, drive):
    return
  for speed in (g for g in speeds if columns.values(g.column).min() >= -UNSIGNED * columns.top(g.column)):
    speed.signed_by = drive
    speed.why.append(f"it carries no sign, and the car drives on under a negative {drive}: backwards")


def _backs_at_times(recordings: Sequence[Recording], drive: str) -> bool:
  """Whether a speed lost the sign of driving backwards; where that would be all of the driving, the command is in
  question."""
  return bool(lost_sign(recordings, drive)) and not against(recordings, drive)
