"""Does anything in a log measure time apart from its stamps?

A rate that a sensor gave (a gyro's, an encoder's, an accelerometer's), compared with how fast something else changed by
the stamps, does. Commands and a pose alone do not: at half the speed of its clock the same log is of a car that drove
twice as fast.
"""

from collections.abc import Sequence

import numpy as np

from calibration.log_check.causes import scaled
from calibration.log_check.disagreements import Finding
from calibration.log_check.motions import CLOCK, Wheels
from calibration.log_check.pairs import Comparison
from calibration.log_check.shows import Driven
from qcar_twin.recordings.completed import UNJUDGED
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import GRAVITY

_MOST = 99.0  # per cent of the samples that stay below what is said of the driving


def clock_findings(
  comparisons: Sequence[Comparison], wheels: Wheels, wheelbase: float, recordings: Sequence[Recording]
) -> list[Finding]:
  """That the clock was not judged, and how the car was driven by it: whoever drove knows that."""
  if any(scaled(c) and CLOCK in c.motion.powers for c in comparisons):
    return []
  d = Driven.of(wheels, wheelbase, recordings)
  across, along = (float(np.percentile(np.abs(v), _MOST)) / GRAVITY for v in (d.across, d.change))
  said = f"the clock {UNJUDGED}: nothing in this log measures time apart from its stamps"
  by_it = f"By them the car reached {d.top:.2g} m/s, {along:.1g} g along and {across:.1g} g across"
  return [Finding("beware", ("time",), f"{said}. {by_it}; if it did not, correct scale of time in [channels]")]
