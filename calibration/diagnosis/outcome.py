"""What a diagnosis found, and the twin it repaired."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.decision.evidence import Evidence
from calibration.diagnosis.formula.after import Shipped
from calibration.diagnosis.holdout_errors import ChannelFit, Replay
from calibration.diagnosis.locate import Location
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.search.detectable import Detectable, detectable
from calibration.fitting.windows import Cut
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Diagnosis:
  """Everything that was found about one data set.

  Attributes:
    dataset: its name.
    decision: verdict and claims.
    location: where the mismatch shows.
    pool: all models tried, with signatures of the scan.
    validate, holdout: error per channel before and after; "before" is the recalibrated twin.
    seconds: wall time.
    stages: wall time of each stage, s, in order.
    next_experiment: manoeuvre, separates, predicted_nats; None where none is needed.
    evidence: what the decision rests on, as plain numbers.
    notes: warnings about the data set that a reader must know.
    formula: of what stays unexplained; None where nothing does, or none was sought.
    replay: the held-out recordings, else those for validation, value by value; None without either.
  """

  dataset: str
  decision: Decision
  location: Location
  pool: Pool
  evidence: Evidence
  validate: Mapping[str, ChannelFit]
  holdout: Mapping[str, ChannelFit]
  seconds: float
  stages: Mapping[str, float] = dataclasses.field(default_factory=dict)
  next_experiment: Mapping[str, Any] | None = None
  notes: tuple[str, ...] = ()
  replay: Replay | None = None
  formula: Shipped | None = None

  @property
  def model(self) -> Candidate:
    """The model behind the claims; the recalibrated twin if there are none."""
    return self.pool.model(self.decision.mechanisms)

  @functools.cached_property
  def detectable(self) -> dict[str, Detectable]:
    """From which size on each mechanism would have been claimed."""
    return detectable(self.pool, self.evidence)


@dataclasses.dataclass(frozen=True)
class Outcome:
  """A diagnosis with the twin it repaired.

  Attributes:
    diagnosis: verdict, location, fits.
    twin: the car with the whole catalogue.
    before, after: parameter vectors of the recalibrated and the repaired twin, (P,).
    cut: how recordings were cut, with the command timing that fitted best.
  """

  diagnosis: Diagnosis
  twin: Twin
  before: Array
  after: Array
  cut: Cut
