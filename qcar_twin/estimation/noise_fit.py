"""Noise of the filters from recordings: the settings under which the measured poses are most likely."""

import dataclasses
import logging
from collections.abc import Callable, Mapping, Sequence

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.offline import events_of, filter_events, missing_pose
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.recordings.recording import Recording, RecordingError
from qcar_twin.vehicle.vehicle import Vehicle

log = logging.getLogger(__name__)
BICYCLE = ("walk_speed", "walk_yaw_rate", "walk_sideslip", "walk_yaw", "walk_position")
POINT = ("walk_point_velocity",)
FACTORS = (0.25, 0.5, 2.0, 4.0)


def evidence(
  recordings: Sequence[Recording],
  car: SingleTrackCar,
  settings: FilterSettings,
  lateness: Mapping[str, float] | None = None,
  vehicle: Vehicle | None = None,
) -> tuple[float, float]:
  """Log likelihood of the poses in EKF_BM and in EKF_PM over recordings: innovations, Gaussian, cut at the gate.

  Lateness in s; the vehicle says which command drives the car, see `events_of`.
  """
  bicycle = point = 0.0
  for recording in recordings:
    federated = FederatedFilter(car, settings, watched=False)  # the fit asks for the noise of sound sensors
    filter_events(events_of(recording, lateness, vehicle=vehicle), federated)
    bicycle, point = bicycle + federated.evidence[0], point + federated.evidence[1]
  return bicycle, point


def fit_noise(
  recordings: Sequence[Recording],
  car: SingleTrackCar,
  settings: FilterSettings,
  lateness: Mapping[str, float] | None = None,
  rounds: int = 2,
  vehicle: Vehicle | None = None,
) -> FilterSettings:
  """The process noise of both filters under which the poses of recordings are most likely; see `most_likely`.

  Args:
    recordings: with a pose as the filter will have it (rate, noise).
    settings: where to begin; the sensors' own noise is taken as known, it cannot be distinguished from the walks.
    lateness: by how much a channel's recorded time is after its measurement, s.
    rounds: over all numbers.
    vehicle: says which command drives the car, see `events_of`.

  Raises:
    RecordingError: no recording, or one without a pose, or with the command of another kind of drive.
  """
  blind = [r.name for r in recordings if missing_pose(r)]
  if blind or not recordings:
    which = f"recording '{blind[0]}' has none" if blind else "no recording to identify with holds one"
    raise RecordingError(
      f"process noise is fitted to measured poses, and {which}; leave the fit out, or give recordings of role"
      ' "identify" with pose_x, pose_y and pose_yaw'
    )
  return most_likely(lambda trial: evidence(recordings, car, trial, lateness, vehicle), settings, rounds)


def most_likely(
  evidence_of: Callable[[FilterSettings], tuple[float, float]], settings: FilterSettings, rounds: int = 2
) -> FilterSettings:
  """Coordinate search over the process noise of both filters, by factors of two and four.

  Args:
    evidence_of: log likelihood of what was measured in EKF_BM and in EKF_PM under settings.
    settings: where to begin.
    rounds: over all numbers.
  """
  best = evidence_of(settings)
  for turn in range(rounds):
    before = settings
    for which, names in ((0, BICYCLE), (1, POINT)):
      for name in names:
        for factor in FACTORS:
          trial = dataclasses.replace(settings, **{name: factor * getattr(before, name)})
          log_likelihood = evidence_of(trial)
          if log_likelihood[which] > best[which]:
            settings, best = trial, log_likelihood
    log.info("noise fit, round %d: log likelihood %.1f and %.1f", turn + 1, *best)
    if settings == before:
      break
  return settings
