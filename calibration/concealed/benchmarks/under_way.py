"""What recalibration makes of sessions without an effect whose recordings begin while the car drives."""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from calibration.concealed.benchmarks.known import CARS
from calibration.concealed.laboratory.written import Session
from calibration.diagnosis.pipeline import prepare
from calibration.fitting.noise_floor import driving_noise, residual_floor
from qcar_twin import markdown
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, Stream

FIRST = 0.2  # s after the beginning of what is scored, where a wrong start shows most
_LAUNCH, _LATER = 0.35, 0.2  # of a recording's largest motor speed, or of its duration, where it is cut
_SHOWN = ("motor_speed", "accel_x", "accel_y", "yaw_rate", "pose_forward", "pose_left")
_LEAST = 2.5  # s that must be left of a recording


@dataclasses.dataclass(frozen=True)
class UnderWay:
  """A session's recalibrated twin.

  Attributes:
    cost: at the minimum, nats.
    errors: root mean square of each channel in multiples of its noise while the car drives: in the first FIRST s of
      the stretches, where a displacement has no value yet, NaN, and later.
  """

  cost: float
  errors: dict[str, tuple[float, float]]


def begun_under_way(recording: Recording, in_launch: bool) -> Recording:
  """A recording from where its motor first turns at a third of its largest speed, or else from a fifth of it on."""
  if "motor_speed" not in recording:
    return recording
  stream = recording["motor_speed"]
  size = np.abs(stream.value)
  later = stream.time[0] + _LATER * (stream.time[-1] - stream.time[0])
  begin = float(stream.time[int(np.argmax(size > _LAUNCH * size.max()))] if in_launch else later)
  if size.max() < 5.0 or stream.time[-1] - begin < _LEAST:
    return recording
  kept = {}
  for name, whole in recording.streams.items():
    some = whole.time >= begin - 1e-9
    kept[name] = Stream(whole.time[some] - begin, whole.value[some])
  return dataclasses.replace(recording, streams=kept)


def recalibrated_under_way(session: Session) -> UnderWay:
  """Recalibrate on a session, every other recording of which begins in a launch and the others in mid-drive."""
  recordings = tuple(begun_under_way(r, k % 2 == 0) for k, r in enumerate(session.recordings))
  cost, own, first = _recalibrated(recordings, session)
  return UnderWay(cost, {name: (_size(e[first[name]]), _size(e[~first[name]])) for name, e in own.items()})


def recalibrated_error(session: Session) -> dict[str, float]:
  """Root mean square error of a session's recalibrated twin over what it is fitted to, in multiples of each channel's
  noise while the car drives."""
  return {name: _size(error) for name, error in _recalibrated(session.recordings, session)[1].items()}


def _recalibrated(
  recordings: Sequence[Recording], session: Session
) -> tuple[float, dict[str, np.ndarray], dict[str, np.ndarray]]:
  """Cost of a recalibration, its errors over each channel's noise, and which of them are of a stretch's beginning."""
  data = DataSet("session", tuple(recordings), session.vehicle, session.vehicle_std)
  recalibrated = prepare(data, threads=1).recalibrated
  problem, observations = recalibrated.problem, recalibrated.problem.observations
  error = problem.exact.raw(recalibrated.theta[None])[0]
  first = observations.time - observations.stretches.first[observations.stretch] < FIRST
  noise = residual_floor(driving_noise(recordings))
  fitted = np.arange(len(error)) < problem.n_train
  own = {name: fitted & observations.select(name) for name in observations.present if noise.get(name)}
  return (
    recalibrated.fit.cost,
    {name: error[rows] / noise[name] for name, rows in own.items()},
    {name: first[rows] for name, rows in own.items()},
  )


def _size(error: np.ndarray) -> float:
  return float(np.sqrt(np.mean(error**2))) if len(error) else np.nan


def under_way_cases(seed: int, count: int) -> list[tuple[str, int]]:
  """So many sessions of either independent car: its name and a seed."""
  return [(car, seed + k) for car in ("first", "second") for k in range(count)]


def under_way_table(cases: Iterable[tuple[str, int]]) -> str:
  """Errors of each session's recalibrated twin, as Markdown."""
  rows = []
  for car, seed in cases:
    session = recalibrated_under_way(CARS[car](seed))
    shown = ["; ".join(f"{e:.2f}" for e in session.errors[name] if np.isfinite(e)) for name in _SHOWN]
    rows.append((f"{car}, {seed}", *shown, f"{session.cost:.0f}"))
  titles = ("car, seed", *(name.replace("_", " ") for name in _SHOWN), "cost [nats]")
  return "\n".join(markdown.table(titles, rows)) + "\n"
