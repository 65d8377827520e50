"""What a diagnosis starts from: the mechanisms it may name."""

from collections.abc import Sequence

from calibration.fitting.dataset_recalibration import Start
from calibration.fitting.tolerances import always_fitted
from qcar_twin.parameters import ParameterSet
from qcar_twin.twin.mechanisms import offered, select
from qcar_twin.twin.mechanisms.base import Mechanism
from qcar_twin.vehicle.drive import DriveKind


def considered(
  candidates: Sequence[str] | None, start: Start | None, drive: DriveKind = "voltage"
) -> tuple[Mechanism, ...]:
  """The mechanisms asked for (all that suit the drive if None), the present twin's, the sensors' small errors."""
  if candidates is None:
    return offered(drive)
  carried = [m.name for m in start[0].mechanisms] if start else []
  return select(dict.fromkeys((*candidates, *carried, *always_fitted(drive))))


def always_free(mechanism: Mechanism, priors: ParameterSet) -> bool:
  """Whether every model fits a mechanism's parameters anyway, over all their range."""
  return any(p.name in priors and priors[p.name].upper == p.upper for p in mechanism.parameters)
