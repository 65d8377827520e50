"""Whether the fitted recordings go everywhere the judging ones go, and what to do where they don't.

An error of the steering to the right can't be learnt from turns to the left. A recording that only judges and
goes where no fitted one goes can veto a name and can't find one: that half of it which goes there more is fitted, too,
and the other half goes on judging, as the hold-out runs do.
"""

import dataclasses

import numpy as np

from calibration.fitting.windows import DEFAULT_CUT
from qcar_twin.kinematics import rolling_radius
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.checks.driving import OUTSIDE, Reach, Shown, least_driven
from qcar_twin.recordings.checks.time import MIN_SAMPLES
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

_WHOLE = 2.0 * DEFAULT_CUT.length  # s: of a shorter recording a half would not fill a stretch, so it stays whole


def with_coverage(dataset: DataSet) -> tuple[DataSet, tuple[str, ...]]:
  """Give what goes far outside what is fitted the role "identify", farthest first, until little is left outside.

  It is what the car was commanded while it was driven, drive and steering, sign and all, how fast it went round and
  from how fast it coasted, and how fast it was told to steer: friction that no fitted drive came near is not learnt
  from commands that were all there one by one, nor what a controller does at neutral from drives that end with the
  brake, nor a servo's largest rate from a slalom that it follows. Recordings are halved, again where half is too
  much or too little; short ones change their role whole. Nothing is changed where no hold-out recording would be left
  to judge.

  Args:
    dataset: recordings with roles.

  Returns:
    the data set with the roles to be used, and a sentence per recording, or part of one, whose role was changed, and
    per hold-out recording that goes outside all the same.
  """
  recordings, notes = list(dataset.recordings), []
  if not dataset.role("holdout") or not dataset.role("identify"):
    return dataset, ()
  least, travel = least_driven(recordings), rolling_radius(Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std))
  amount = lambda one: one.outside(reach) * len(one)
  while True:
    shown = [Shown.of(r, least) for r in recordings]
    reach = Reach.of([s for r, s in zip(recordings, shown, strict=True) if r.role == "identify"])
    judging = [i for i, r in enumerate(recordings) if r.role == "validate" and len(shown[i])]
    outside = {i: amount(shown[i]) for i in judging}
    if reach is None or sum(outside.values()) <= OUTSIDE * sum(len(shown[i]) for i in judging):
      break
    i = max(judging, key=outside.__getitem__)
    pieces = _halves(recordings[i])
    of_pieces = [Shown.of(p, least) for p in pieces]
    taken = max(range(len(pieces)), key=lambda k: amount(of_pieces[k]))
    notes.append(_sentence(pieces[taken], of_pieces[taken], reach, travel))
    pieces[taken] = pieces[taken].replace(role="identify")
    recordings[i : i + 1] = pieces
  for recording, one in zip(recordings, shown, strict=True):
    if reach is not None and recording.role == "holdout" and one.outside(reach) > OUTSIDE:
      notes.append(_opened(recording, one, reach, travel))
  return dataclasses.replace(dataset, recordings=tuple(recordings)), tuple(notes)


def _halves(recording: Recording) -> list[Recording]:
  """A recording cut in the middle; as it is where it is short, or one half would hardly tell how fast the car was."""
  middle = 0.5 * (recording.start + recording.end)
  speeds = [recording[name].time for name in ("motor_speed", "speed") if name in recording]
  shown = max((min(np.sum(t < middle), np.sum(t >= middle)) for t in speeds), default=0)
  if recording.duration < _WHOLE or shown < MIN_SAMPLES:
    return [recording]
  spans = (recording.start, float(np.nextafter(middle, -np.inf))), (middle, recording.end)
  first, second = (recording.window(*s).replace(name=f"{recording.name}#{k}") for k, s in enumerate(spans, 1))
  return [first, second.replace(before=None)]  # what was driven before it is counted again, the first half with it


def _sentence(piece: Recording, shown: Shown, reach: Reach, travel: float) -> str:
  return (
    f"{piece.name} ({piece.start:.1f} s to {piece.end:.1f} s) was fitted although its role is validate:"
    f" {_outside(piece, shown, reach, travel)}, and no"
    " recording with the role identify goes there. The rest and the hold-out recordings judge what came of it."
  )


def _opened(recording: Recording, shown: Shown, reach: Reach, travel: float) -> str:
  return (
    f"{recording.name} is a hold-out recording and goes where nothing that is fitted goes:"
    f" {_outside(recording, shown, reach, travel)}. Its errors there say how the twin goes on beyond what it learnt."
  )


def _outside(recording: Recording, shown: Shown, reach: Reach, travel: float) -> str:
  """What of a recording lies outside most, as part of a sentence; the motor's travel is in m per rad."""
  beyond = shown.beyond(reach)
  k, speed = int(np.argmax(beyond)), travel if "motor_speed" in recording else 1.0
  if k == len(reach.low):
    return f"{100.0 * beyond[k]:.0f} % of its driving is coasting faster than {speed * reach.coasted:.3g} m/s"
  if k > len(reach.low):
    return (
      f"{100.0 * beyond[k]:.0f} % of the turns of its steering_command go farther than {reach.told:.3g} rad in 0.1 s"
    )
  scale = speed if k == 2 else 1.0
  what = (recording.drive_channel, "steering_command", "the lateral acceleration")[k]
  unit = "m/s^2" if k == 2 else CHANNELS[what].unit
  between = f"{scale * reach.low[k]:.3g} to {scale * reach.high[k]:.3g} {unit}".removesuffix(" -")
  return f"{100.0 * beyond[k]:.0f} % of its driving has {what} outside {between}"
