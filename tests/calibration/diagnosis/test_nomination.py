"""Every mechanism of the catalogue: the data it made itself lead the scan to it."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.scan import scan, trial_starts
from calibration.diagnosis.search.structure import Effort
from calibration.fitting.observations import CHANNELS
from qcar_twin.plant import SIGNALS
from qcar_twin.twin.mechanisms import offered
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.twin.mechanisms.test_twin import segments, sized

ALL = offered("voltage")
NOISE = {"pose_x": 3e-3, "pose_y": 3e-3, "pose_yaw": 5e-3, "yaw_rate": 0.02, "accel_x": 0.3, "accel_y": 0.3,
         "motor_speed": 4.0}  # m, rad, rad/s, m/s^2 # fmt: skip
COLUMNS = [SIGNALS.index(name) for name in NOISE]


class Drives:
  """Whitened signals of a twin with the whole catalogue on two drives; what a scan asks of a Problem."""

  def __init__(self):
    self.twin = Twin(Vehicle.load(), ALL, threads=1)
    self.parameters, self.segments = self.twin.parameters, segments()
    self.driving, self.observations = self.segments.driving, SimpleNamespace(present=frozenset(CHANNELS))
    self._known, self.data = {}, 0.0

  def shown(self, thetas):
    """(n, K); a vector is simulated once."""
    new = {t.tobytes(): t for t in thetas if t.tobytes() not in self._known}
    if new:
      signals = self.twin.rollout(np.stack(list(new.values())), self.segments).signals[..., 1:, COLUMNS]
      white = (signals / list(NOISE.values())).reshape(len(new), -1)
      self._known |= dict(zip(new, white, strict=True))
    return np.stack([self._known[t.tobytes()] for t in thetas])

  def fitted_residual(self, thetas):
    return self.shown(thetas) - self.data

  def base(self) -> Candidate:
    """The nominal twin, with the columns of all its parameters."""
    base, theta = self.twin.base, self.parameters.nominal
    steps = 0.03 * base.scale
    moved = np.stack([theta, *(theta + step * np.eye(len(theta))[i] for i, step in enumerate(steps))])
    here, *others = self.fitted_residual(moved)
    slopes = np.stack([(other - here) / step for other, step in zip(others, steps, strict=True)], axis=-1)
    return Candidate((), base, theta, here, slopes, base.nominal, len(here))


@pytest.fixture(scope="module")
def drives() -> Drives:
  """With everything simulated in one go."""
  made = Drives()
  tried = [made.parameters.vector(start) for m in ALL for start in trial_starts(m, (0.8, -0.8), made.driving)]
  made.shown([*tried, *(sized(made.twin, m, 1.3) for m in ALL)])
  return made


FOURTH = pytest.mark.xfail(reason="its 1.3 of a typical size passes for a friction that changes", strict=True)


@pytest.mark.parametrize(
  "mechanism", [pytest.param(m, id=m.name, marks=FOURTH if m.name == "load_transfer" else ()) for m in ALL]
)
def test_its_own_data_lead_the_scan_to_a_mechanism(drives, mechanism):
  """Though the scan tried another size, one amplitude at a time, and though recalibration may imitate it.

  Among the first three, all of which are refitted: a delay of 40 ms and a lag of it are told apart by the fit.
  """
  drives.data = drives.shown([sized(drives.twin, mechanism, 1.3)])[0]
  signatures = scan(drives, drives.base(), ALL)
  assert signatures[mechanism.name].testable
  ranked = sorted(signatures, key=lambda name: -signatures[name].gain)
  assert mechanism.name in ranked[:3] and len(ranked) == len(ALL) and Effort().singles >= 3
