"""Which recordings are fitted, which choose between models and which are kept for the end: a proposal.

Many files share the roles out in turn, so that every kind of driving has each; few long ones are cut by time.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.recording import Recording

_TURNS = ("identify", "identify", "validate", "identify", "holdout")  # of five files of one kind
_FEW = {
  2: ("identify", "holdout"),
  3: ("identify", "validate", "holdout"),
  4: ("identify", "identify", "validate", "holdout"),
}
_SHARES = (("identify", 0.6), ("validate", 0.2), ("holdout", 0.2))  # of a file that is cut
_LONG = 30.0  # s, of a file that can be cut
_STILL, _LEVEL = 0.02, 0.95  # of the largest command: nothing; share of a step's time at rest or at its level


@dataclass(frozen=True)
class Part:
  """One [[recording]]: a file, or the part between `begin` and `end`, s on its own clock."""

  file: str
  role: str
  begin: float | None = None
  end: float | None = None
  manoeuvre: str = ""
  why: str = ""
  why_manoeuvre: str = ""


def share_out(recordings: Sequence[Recording], drive_steps: str) -> list[Part]:
  """Roles for recordings, one per file, in the order they were driven.

  Args:
    recordings: whole files.
    drive_steps: what a step of this car's drive command is called as a manoeuvre; "" where it identifies nothing.
  """
  groups: dict[str, list[int]] = {}
  for place, recording in enumerate(recordings):
    groups.setdefault(re.sub(r"\d.*$", "", recording.file), []).append(place)
  roles: dict[int, tuple[str, str]] = {}
  rest = [place for group in groups.values() if len(group) < len(_TURNS) for place in group]
  for group in [*(g for g in groups.values() if len(g) >= len(_TURNS)), rest]:
    given = _FEW.get(len(group)) or [_TURNS[k % len(_TURNS)] for k in range(len(group))]
    why = f"{len(group)} files take turns" if len(group) > 1 else "the only one of its kind"
    roles |= {place: (role, why) for place, role in zip(sorted(group), given, strict=True)}
  parts = []
  for place, recording in enumerate(recordings):
    manoeuvre, seen = manoeuvre_of(recording, drive_steps)
    if len(recordings) < 3 and recording.duration >= _LONG:
      parts += _cut(recording, manoeuvre, seen)
    else:
      parts.append(Part(recording.file, roles[place][0], None, None, manoeuvre, roles[place][1], seen))
  return parts


def _cut(recording: Recording, manoeuvre: str, seen: str) -> list[Part]:
  begin, parts = recording.start, []
  for number, (role, share) in enumerate(_SHARES):
    end = round(begin + share * recording.duration, 3)
    last = number == len(_SHARES) - 1
    why = f"{100 * share:.0f} % of {recording.duration:.0f} s, by time"
    first = None if number == 0 else begin
    parts.append(Part(recording.file, role, first, None if last else end, manoeuvre, why, seen))
    begin = end
  return parts


def manoeuvre_of(recording: Recording, drive_steps: str) -> tuple[str, str]:
  """A label that the identification goes by, and the reason for it; empty where the driving is none of them."""
  drive = recording[recording.drive_channel].value
  most = float(np.abs(drive).max())
  steering = recording["steering_command"].value if "steering_command" in recording else np.zeros(1)
  turned = float(np.ptp(steering))
  if most == 0.0 and turned == 0.0:
    return "standstill", "no command"
  level = drive[np.abs(drive) > _STILL * most]
  usual = float(np.median(level)) if level.size else 0.0
  stepped = np.mean((np.abs(drive) <= _STILL * most) | (np.abs(drive - usual) <= _STILL * most)) >= _LEVEL
  if drive_steps and stepped and level.size and turned <= 0.02:
    return drive_steps, "one level of the drive's command, straight on"
  return "", ""
