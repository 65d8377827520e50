"""A twin with curves as it is shipped: without the lead by which commands were moved earlier for the fit."""

from types import SimpleNamespace

import pytest

from calibration.diagnosis.curves.flexible import Characterised
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

BESIDE = ("steering_delay", "steering_lag")


def shipped(delay: float, lag: float, servo: float) -> dict[str, float]:
  """Values of a twin that was fitted to commands moved 0.02 s earlier."""
  twin = Twin(Vehicle.load(), select(BESIDE), substeps=2, threads=1)
  theta = twin.parameters.nominal.copy()
  for name, value in (("steering_delay", delay), ("steering_lag", lag), ("servo_time_constant", servo)):
    theta[twin.parameters.index(name)] = value
  fitted = SimpleNamespace(problem=SimpleNamespace(exact=SimpleNamespace(twin=twin)), theta=theta, command_shift=-2)
  made = Characterised(fitted, (), BESIDE)  # type: ignore[arg-type]
  assert made.lead == pytest.approx(0.02)
  named = twin.parameters.named(made.unshifted)
  return {name: named[name] for name in ("steering_delay", "steering_lag", "servo_time_constant")}


@pytest.mark.parametrize(
  ("fitted", "expected"),
  [
    ((0.05, 0.03, 0.01), (0.03, 0.03, 0.01)),  # the delay holds the lead
    ((0.005, 0.03, 0.01), (0.0, 0.015, 0.01)),  # the lag gives what the delay lacks
    ((0.0, 0.015, 0.01), (0.0, 0.0, 0.005)),  # and the servo what that lacks
  ],
)
def test_a_lead_is_taken_off_the_delay_and_then_off_what_lags(fitted, expected):
  assert tuple(shipped(*fitted).values()) == pytest.approx(expected)
