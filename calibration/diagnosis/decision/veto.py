"""Which twin may never be written: one that predicts worse than the recalibrated one, or can't reach logged speeds."""

from collections.abc import Iterable

from calibration.diagnosis.decision.evidence import HeldOutError
from calibration.diagnosis.decision.levels import Levels


def surely_worse(errors: Iterable[HeldOutError], levels: Levels) -> tuple[HeldOutError, ...]:
  """Channels whose error grows by more than what matters (`gain`), its interval above zero."""
  return tuple(e for e in errors if e.after > (1.0 + levels.gain) * e.before and e.ci95[0] > 0.0)


def falls_short(reached: float, logged: float, without: float, levels: Levels) -> bool:
  """Whether a twin misses the fast end of what was logged by more than `short`, and by more than the simpler one.

  Args:
    reached, logged, without: speeds of the twin, of the recordings, of the recalibrated twin; one unit.
  """
  return reached < (1.0 - levels.short) * logged and reached < without
