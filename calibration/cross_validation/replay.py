"""Both models on the same stretches of driving: what was measured and what each predicts, value by value."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.observations import UNITS, Observations, observe
from calibration.fitting.windows import Cut
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.plant import Prediction, Segments
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ReferenceBicycle:
  """The bicycle to compare with: its parameters (5,) and, in words, where they are from."""

  bicycle: Bicycle
  theta: Array
  origin: str


@dataclasses.dataclass(frozen=True)
class Score:
  """Error of one model on one channel, in `unit`; NRMSE without unit."""

  rmse: float
  nrmse: float
  samples: int
  unit: str


@dataclasses.dataclass(frozen=True, eq=False)
class Replay:
  """One window length: what was measured and predicted, value by value.

  Attributes:
    window: s; inf for the free run.
    predicted: model -> values, (M,).
  """

  window: float
  observations: Observations
  predicted: Mapping[str, Array]

  def scores(self, model: str, recording: int | None = None) -> dict[str, Score]:
    """By channel; of one recording, by its index, or of all."""
    chosen = {}
    for channel in self.observations.present:
      rows = self.observations.select(channel)
      if recording is not None:
        rows &= self.observations.recording == recording
      if rows.any():
        chosen[channel] = _score(self.predicted[model][rows], self.observations.measured[rows], UNITS[channel])
    return chosen

  @property
  def name(self) -> str:
    """The window in words."""
    return f"{self.window:g} s" if math.isfinite(self.window) else "free run"


def replay(
  twin: Twin,
  theta: Array,
  reference: ReferenceBicycle | None,
  recordings: Sequence[Recording],
  window: float,
  command_shift: int,
) -> Replay:
  """Both models on recordings cut into windows; inf for free runs."""
  cut = Cut(length=window, warm_up=0.0, command_shift=command_shift)
  observations = observe(recordings, twin.vehicle, cut, horizon=min(1.0, 0.8 * window))
  segments = observations.stretches.segments
  predicted = {"twin": observations.predict(twin.rollout(theta, segments))[0]}
  if reference:
    seen = as_seen(twin, theta, reference.bicycle.rollout(reference.theta, segments), segments)
    predicted["bicycle"] = observations.predict(seen)[0]
  return Replay(window, observations, predicted)


def as_seen(twin: Twin, theta: Array, prediction: Prediction, segments: Segments) -> Prediction:
  """A prediction (1, S, T + 1, 10) as the sensors of a twin with parameters (P,) show it: biases, latencies."""
  signals = prediction.signals[0].copy()
  signals = twin.sensed(np.tile(theta, (len(segments), 1)), signals, segments.offset)
  return Prediction(signals[None], prediction.period)


def _score(predicted: Array, measured: Array, unit: str) -> Score:
  rmse = float(np.sqrt(np.mean(np.square(predicted - measured))))
  spread = float(np.std(measured))
  return Score(rmse, rmse / spread if spread > 0.0 else math.nan, len(measured), unit)
