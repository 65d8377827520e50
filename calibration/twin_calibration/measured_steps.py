"""The measured responses to the steps that twin and bicycle answer, from the recordings they were identified with."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.identification.drive_fit import STANDING, motor_steps
from calibration.identification.match_bicycle import SPEED, Answer, step_speed
from calibration.identification.steering_steps import Turn, find_turns
from calibration.identification.step_detection import Step
from qcar_twin.bicycle.bicycle import drive_of
from qcar_twin.kinematics import rolling_radius
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

_SAME = 0.02  # share of a level within which a measured step is the one that was answered
_SPEED = 0.1  # share of the answered step's speed within which a measured turn is shown with it


@dataclasses.dataclass(frozen=True, eq=False)
class MeasuredSteps:
  """Steps found in recordings: of the drive command from rest, and of the steering; `speed` of the answers, m/s."""

  drives: tuple[Step, ...]
  turns: tuple[Turn, ...]
  speed: float = SPEED

  def response(self, answer: Answer) -> tuple[Array, Array] | None:
    """Time since the step [s] and the measured channel in its unit, both (T,); None where no step is like it.

    A step of the drive has to start at rest, a step steer at the speed of the answer, or the two do not compare.
    """
    if answer.channel == "motor_speed":
      return next((_from(s, s.measured["motor_speed"]) for s in self.drives if _same(s, answer) and _at_rest(s)), None)
    usable = [t for t in self.turns if answer.channel in t.signals and _same(t.step, answer)]
    off = lambda turn: abs(float(np.mean(turn.speed[: max(turn.step.first, 1)])) / self.speed - 1.0)
    nearest = min(usable, key=off, default=None)
    return _from(nearest.step, nearest.signals[answer.channel]) if nearest and off(nearest) <= _SPEED else None


def measured_steps(recordings: Sequence[Recording], vehicle: Vehicle) -> MeasuredSteps:
  """Every step of recordings that are not held out."""
  seen = [r for r in recordings if r.role != "holdout"]
  drives, _ = motor_steps(seen, rolling_radius(vehicle), drive_of(vehicle)) if vehicle.motor.steps else ((), False)
  return MeasuredSteps(tuple(drives), tuple(find_turns(seen, vehicle)), step_speed(vehicle))


def _same(step: Step, answer: Answer) -> bool:
  return step.role == answer.level.role and abs(step.level - answer.level.value) <= _SAME * abs(answer.level.value)


def _at_rest(step: Step) -> bool:
  """Whether the motor stands when the command changes."""
  values = np.abs(step.measured["motor_speed"])
  return bool(values[step.first] <= STANDING * np.nanmax(values))


def _from(step: Step, values: Array) -> tuple[Array, Array]:
  return step.time[step.first :], values[step.first :]
