"""What a characterised twin is worth on a session that it was not fitted to.

Each session is left out in turn: the twin is fitted to the others and drives the session's recordings, first with the
mean of what sessions shift, a servo's trim and the drive's gain, then with shifts of the session's own. Those are
fitted to one half of its recordings and judged on the other, both ways round, so that no recording is judged by numbers
that it gave. The hold-out stays closed.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.black_box import rms
from calibration.diagnosis.candidates import Candidate, refine, simulate
from calibration.diagnosis.curves.driven import driven, error_of
from calibration.diagnosis.curves.flexible import GAIN, TRIM, Characterised, characterise
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.fitting.likelihood import Problem
from calibration.fitting.observations import UNITS, observe
from calibration.fitting.windows import Cut
from calibration.log_check.ready import ready
from calibration.progress import Progress, silent
from qcar_twin.parameters import ParameterSet
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]

_STEPS = 6  # of Gauss-Newton over two numbers


@dataclasses.dataclass(frozen=True)
class LeftOut:
  """A session driven by a twin that was fitted to the others.

  Attributes:
    session: its name; recordings: how many it has.
    mean, own: root mean square errors per channel with the mean shifts and with its own, {} without two recordings.
    units: of the channels.
  """

  session: str
  recordings: int
  mean: Mapping[str, float]
  own: Mapping[str, float]
  units: Mapping[str, str]


def leave_sessions_out(
  dataset: DataSet, most: float = LONGEST, threads: int = 0, progress: Progress = silent
) -> tuple[LeftOut, ...]:
  """Every session of a data set in turn.

  Args:
    dataset: as `study` takes it; its hold-out is not looked at.
    most: s of driving that each twin is fitted to.
    threads: of the simulation, 0 for all cores.
    progress: reports which session.

  Raises:
    ValueError: fewer than two sessions have recordings beside the hold-out.
  """
  dataset, _ = ready(dataset, most)
  kept = [r for r in dataset.recordings if r.role != "holdout"]
  sessions = sorted({r.session for r in kept if r.session})
  if len(sessions) < 2:
    raise ValueError(
      f"data set {dataset.name}: {len(sessions)} session(s) with recordings beside the hold-out, leaving one out takes "
      "two; say which session a recording belongs to by `session = NAME` in dataset.toml"
    )
  made = []
  for session in sessions:
    progress(f"without session {session}")
    others = tuple(r for r in kept if r.session != session)
    found = characterise(dataclasses.replace(dataset, recordings=others), most=most, threads=threads)
    made.append(_judged(found, session, [r for r in kept if r.session == session]))
  return tuple(made)


def _judged(found: Characterised, session: str, recordings: Sequence[Recording]) -> LeftOut:
  mean = error_of(found.fitted, recordings)
  units = {name: UNITS[name] for name in mean}
  halves = recordings[::2], recordings[1::2]
  if not halves[1]:
    return LeftOut(session, len(recordings), mean, {}, units)
  squares: dict[str, list[tuple[float, int]]] = {}
  for fitted, judged in (halves, halves[::-1]):
    other, _, left = driven(found.fitted, judged, _with_own_shifts(found, fitted))
    for name, value in rms(other, left).items():
      squares.setdefault(name, []).append((value, int(np.sum(other.select(name)))))
  own = {n: float(np.sqrt(np.average([v**2 for v, _ in x], weights=[k for _, k in x]))) for n, x in squares.items()}
  return LeftOut(session, len(recordings), mean, own, units)


def _with_own_shifts(found: Characterised, recordings: Sequence[Recording]) -> Array:
  """All parameters, (P,), with trim and gain fitted to a session's recordings and everything else as it is."""
  cut = Cut(command_shift=found.fitted.command_shift, most=LONGEST)
  observations = observe(recordings, found.twin.vehicle, cut)
  searched = found.fitted.problem
  gain = found.twin.vehicle.motor.gain
  known = searched.parameters.named(found.theta)
  stds = {"steering_offset": TRIM, gain: GAIN * abs(known[gain])}
  free = ParameterSet(
    dataclasses.replace(searched.parameters[n], nominal=known[n], std=std) for n, std in stds.items() if n in known
  )
  weighting = dataclasses.replace(searched.weighting, spike=np.ones(len(observations)))
  problem = Problem(searched.twin, observations, weighting, len(observations), free.names)
  empty = np.zeros((len(observations), len(free)))
  model = Candidate((), free, found.theta.copy(), empty[:, 0], empty, free.nominal, len(observations))
  simulate(problem, [model])
  refine(problem, [model], _STEPS, full=True)
  return model.theta


def sentences(found: Sequence[LeftOut]) -> list[str]:
  """What the terminal says, a line a session and channel."""
  lines = []
  for item in found:
    lines.append(f"session {item.session}, {item.recordings} recordings, by a twin fitted to the others:")
    for name, value in item.mean.items():
      own = f", with its own {item.own[name]:.4g}" if name in item.own else ""
      lines.append(f"  {name} [{item.units[name]}]: with the mean trim and gain {value:.4g}{own}")
  return lines
