"""The location: when, in which channels, on which degree of freedom and under which circumstances the twin is wrong.

The unit is evidence in nats: how much the model behind the claim lowers half the sum of squares at
each value. Without a claim it is what the residual holds above the sensors' own noise.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.circumstances import UNITS, Circumstances, circumstances
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.region import Region, find_region
from calibration.diagnosis.unexplained.unknown import SUBSYSTEM
from calibration.fitting.observations import CHANNELS, Observations
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

_CARRIES = 0.8  # share of the evidence that the named seconds carry
_MOST_SPANS = 12
_BIN = 10  # control periods that count as one moment for the region


@dataclasses.dataclass(frozen=True)
class Span:
  """Seconds of one recording that carry a share of the evidence."""

  recording: str
  start: float
  end: float
  share: float


@dataclasses.dataclass(frozen=True)
class Location:
  """Where the mismatch shows.

  Attributes:
    source: "claim", "unknown" or "residual": what the evidence is measured by.
    subsystem: command, steering, tyre, ground, drive, body, sensor, or "none" without a mismatch.
    channels: share of the evidence per channel, largest first.
    degrees: degree of freedom or sensor an unknown error would have to act on, e.g. "force_x", and its held-out gain,
      nats, largest first; {} if none was tried.
    time: the seconds that carry the evidence, largest share first.
    region: the circumstances as a rule to read.
    evidence: nats per measured value, (M,).
  """

  source: str
  subsystem: str
  channels: dict[str, float]
  degrees: dict[str, float]
  time: tuple[Span, ...]
  region: Region
  evidence: Array


def locate(
  pool: Pool,
  model: Candidate,
  unknown_gains: Mapping[str, float] | None = None,
  unknown: Candidate | None = None,
  claimed: Sequence[str] = (),
) -> Location:
  """Say where the mismatch is.

  Args:
    pool: all fitted models, with the recalibrated twin as its base.
    model: the model behind the claims; the base if nothing is claimed.
    unknown_gains: held-out gain of every UNKNOWN rival over the base, nats, by name ("unknown_force_x").
    unknown: the best UNKNOWN rival where the verdict rests on it (nothing claimed, yet a mismatch).
    claimed: all claimed mechanisms; those that are part of every model (IMU biases) are located by
      what leaving them out would cost when nothing else is claimed.
  """
  gains = dict(sorted((unknown_gains or {}).items(), key=lambda kv: -kv[1]))
  base, observations = pool.base, pool.problem.observations
  nuisances = [n for n in claimed if n not in model.mechanisms] if not model.mechanisms else []
  if nuisances and unknown is None:
    source, evidence = "claim", nuisance_evidence(pool, nuisances)
  else:
    source = "claim" if model.mechanisms else ("unknown" if unknown is not None else "residual")
    evidence = value_evidence(pool, model if model.mechanisms else unknown)
  problem = pool.problem
  prediction = problem.exact.predict(base.theta[None])
  law = torque_law(problem.twin.vehicle, dict(zip(problem.parameters.names, base.theta, strict=True)))
  around = circumstances(observations, prediction, *law)
  return Location(
    source=source,
    subsystem=_subsystem(pool, model, unknown, nuisances),
    channels=evidence_shares(evidence, observations),
    degrees={name.removeprefix("unknown_"): gain for name, gain in gains.items()},
    time=evidence_spans(evidence, observations),
    region=region_of(evidence, observations, around, pool.problem.twin.vehicle.motor.unit),
    evidence=evidence,
  )


def value_evidence(pool: Pool, better: Candidate | None) -> Array:
  """Nats per value, (M,): drop of half the squared residual; without a better model its excess over noise."""
  base, observations = pool.base, pool.problem.observations
  if better is not None:
    return 0.5 * (base.residual**2 - better.residual**2)
  floor = np.array([pool.floor.get(name, 0.0) for name in CHANNELS])[observations.channel]
  return 0.5 * (base.residual**2 - pool.problem.whiten(floor) ** 2)


def nuisance_evidence(pool: Pool, mechanisms: Sequence[str]) -> Array:
  """Nats per value, (M,), that mechanisms which are part of every model bring, to first order."""
  base = pool.base
  names = {p.name for m in mechanisms for p in pool.problem.mechanism(m).parameters}
  columns = [i for i, name in enumerate(base.free.names) if name in names]
  without = base.residual - base.jacobian[:, columns] @ base.values[columns]
  return 0.5 * (without**2 - base.residual**2)


def evidence_shares(evidence: Array, observations: Observations) -> dict[str, float]:
  """Share of the evidence each channel holds, largest first; a channel that speaks against it has none."""
  sums = {
    CHANNELS[i]: max(float(evidence[observations.channel == i].sum()), 0.0) for i in np.unique(observations.channel)
  }
  total = sum(sums.values()) or 1.0
  return {name: value / total for name, value in sorted(sums.items(), key=lambda kv: -kv[1])}


def evidence_spans(evidence: Array, observations: Observations, carries: float = _CARRIES) -> tuple[Span, ...]:
  """The fewest blocks that together carry a share of the evidence, neighbours merged, largest first.

  Shares are of the sum over all blocks that speak for the mismatch.
  """
  block = observations.block
  sums = np.bincount(block, evidence)
  sums[np.bincount(block, minlength=len(sums)) == 0] = 0.0
  total = float(np.maximum(sums, 0.0).sum())
  if total <= 0:
    return ()
  order = np.argsort(-sums)
  count = int(np.searchsorted(np.cumsum(np.maximum(sums[order], 0.0)), carries * total)) + 1
  chosen = sorted(int(b) for b in order[:count] if sums[b] > 0)
  spans = [_block_span(observations, b, sums[b] / total) for b in chosen]
  merged = spans[:1]
  for previous, (span, number) in zip(chosen, zip(spans[1:], chosen[1:], strict=True), strict=False):
    if span.recording == merged[-1].recording and number == previous + 1:
      merged[-1] = Span(span.recording, merged[-1].start, span.end, merged[-1].share + span.share)
    else:
      merged.append(span)
  return tuple(sorted(merged, key=lambda s: -s.share)[:_MOST_SPANS])


def region_of(evidence: Array, observations: Observations, around: Circumstances, drive_unit: str = "V") -> Region:
  """The rule on the circumstances that holds most of the evidence in the least time; `drive_unit` of the command."""
  grid = observations.stretches.segments.commands.shape[1] + 1
  point = observations.grid_points
  per_segment = -(-grid // _BIN)
  moment = (point // grid) * per_segment + (point % grid) // _BIN
  kinds, first, inverse = np.unique(moment, return_index=True, return_inverse=True)
  sums = np.bincount(inverse.reshape(-1), evidence).astype(np.float64)
  segment, step = kinds // per_segment, np.minimum((kinds % per_segment) * _BIN + _BIN // 2, grid - 1)
  features = around.stacked()[segment, step]
  units = UNITS | {"abs(drive_command)": drive_unit}
  return find_region(features, around.names, units, sums, observations.block[first])


def _block_span(observations: Observations, number: int, share: float) -> Span:
  rows = np.flatnonzero(observations.block == number)
  time = observations.time[rows]
  return Span(observations.names[observations.recording[rows[0]]], float(time.min()), float(time.max()), float(share))


def _subsystem(pool: Pool, model: Candidate, unknown: Candidate | None, nuisances: Sequence[str]) -> str:
  """Of the mechanism whose removal would cost most, else of the unknown rival, else none."""
  if model.mechanisms:
    return pool.problem.mechanism(_heaviest(pool, model)).subsystem
  if unknown is not None:
    return subsystem_of_unknown(unknown.mechanisms[0])
  return pool.problem.mechanism(nuisances[0]).subsystem if nuisances else "none"


def subsystem_of_unknown(name: str) -> str:
  """Subsystem of an UNKNOWN rival: "unknown_sensor_yaw_rate" -> "sensor", "unknown_voltage" -> "drive"."""
  bare = name.removeprefix("unknown_")
  return "sensor" if bare.startswith("sensor") else SUBSYSTEM.get(bare, "body")


def _heaviest(pool: Pool, model: Candidate) -> str:
  cost: dict[str, float] = {}
  for name in model.mechanisms:
    without = pool.models.get(frozenset(model.mechanisms) - {name})
    cost[name] = without.cost if without is not None else -np.inf
  return max(cost, key=lambda n: cost[n])


def torque_law(vehicle: Vehicle, values: Mapping[str, float]) -> tuple[float, float]:
  """Motor torque per unit of the logged command, N m, and its damping, N m s/rad, of a car with such parameters."""
  return vehicle.command_scale * values[vehicle.motor.gain], values["motor_damping"]
