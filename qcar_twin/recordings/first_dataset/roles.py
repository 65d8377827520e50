"""Which recordings are fitted, which choose between models and which are kept for the end: a proposal.

Many files share the roles out in turn, so that every kind of driving has each; few long ones are cut by time. One that
would only judge and goes where no fitted one goes changes places with the one that the others cover best: how a twin
answers to what it never saw is no measure of it.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import PurePosixPath

import numpy as np

from qcar_twin.recordings.checks.driving import OUTSIDE, Reach, Shown, least_driven
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
  """One [[recording]]: a file, or a part of it from `begin` to `end`, s on its clock, with a name of its own."""

  file: str
  role: str
  begin: float | None = None
  end: float | None = None
  manoeuvre: str = ""
  why: str = ""
  why_manoeuvre: str = ""
  name: str = ""


def as_driven(recordings: Sequence[Recording]) -> list[Recording]:
  """The same recordings in the order they were driven, where every clock is a date's and one ends before the next
  begins; else as they are given: the names of files seldom tell, and heat and charge carry on from one to the next."""
  if not all(recording.origin[0] for recording in recordings):
    return list(recordings)
  in_turn = sorted(recordings, key=lambda recording: recording.origin[0] + recording.start)
  apart = all(a.origin[0] + a.end <= b.origin[0] + b.start for a, b in pairwise(in_turn))
  return in_turn if apart else list(recordings)


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
  kinds = [*(g for g in groups.values() if len(g) >= len(_TURNS)), rest]
  for group in kinds:
    given = _FEW.get(len(group)) or [_TURNS[k % len(_TURNS)] for k in range(len(group))]
    why = f"{len(group)} files take turns" if len(group) > 1 else "the only one of its kind"
    roles |= {place: (role, why) for place, role in zip(sorted(group), given, strict=True)}
  roles = _covered(recordings, kinds, roles)
  parts = []
  for place, recording in enumerate(recordings):
    manoeuvre, seen = manoeuvre_of(recording, drive_steps)
    if len(recordings) < 3 and recording.duration >= _LONG:
      parts += _cut(recording, manoeuvre, seen)
    else:
      parts.append(Part(recording.file, roles[place][0], None, None, manoeuvre, roles[place][1], seen))
  return parts


def _covered(
  recordings: Sequence[Recording], kinds: Sequence[Sequence[int]], roles: dict[int, tuple[str, str]]
) -> dict[int, tuple[str, str]]:
  """The roles, where what is fitted covers what judges as far as it can: hold-out first, each within its kind."""
  least = least_driven(recordings) if recordings else (0.0, 0.0)
  shown = {place: Shown.of(recording, least) for place, recording in enumerate(recordings)}
  for judges in ("holdout", "validate"):
    for place in [p for p, (role, _) in sorted(roles.items()) if role == judges]:

      def away(one: int, place: int = place) -> float:
        others = [p for p, (role, _) in roles.items() if role == "identify" and p != one]
        return shown[one].outside(Reach.of([shown[p] for p in (*others, *({place} - {one}))]))

      kind = next(group for group in kinds if place in group)
      if away(place) <= OUTSIDE:
        continue
      best = min((p for p in kind if roles[p][0] == "identify"), key=away, default=place)
      if away(best) < away(place):
        roles[best] = (judges, f"of {len(kind)} files what it does the fitted ones do, too")
        roles[place] = ("identify", "goes where no other one does")
  return roles


def _cut(recording: Recording, manoeuvre: str, seen: str) -> list[Part]:
  """By the samples of the speed: a logger's stale rows, or a pause, take no share."""
  stem, parts = PurePosixPath(recording.file).stem, []
  time = recording["motor_speed" if "motor_speed" in recording else "speed"].time
  edges = [None, *(float(time[int(len(time) * share)]) for share in np.cumsum([s for _, s in _SHARES])[:-1]), None]
  for number, (role, share) in enumerate(_SHARES):
    why = f"{100 * share:.0f} % of the samples, by time"
    name = f"{stem}_{number + 1}"
    parts.append(Part(recording.file, role, edges[number], edges[number + 1], manoeuvre, why, seen, name))
  return parts


def manoeuvre_of(recording: Recording, drive_steps: str) -> tuple[str, str]:
  """A label that the identification goes by, and the reason for it; empty where the driving is none of them."""
  if recording.drive_channel not in recording:
    return "", ""
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
