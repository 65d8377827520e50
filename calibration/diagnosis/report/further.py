"""What a stage after the diagnosis adds to its results: words, sections, a key of diagnosis.json, another twin."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from calibration.diagnosis.holdout_errors import ChannelFit
from calibration.diagnosis.shipping import Written
from qcar_twin.pages import Section


@dataclasses.dataclass(frozen=True)
class Further:
  """Results of a stage that the diagnosis itself does not know.

  Attributes:
    sentence: said right after the verdict; "" for nothing.
    facts: numbers that go with the verdict.
    sections: shown after "The repaired model".
    curves: key "curves" of diagnosis.json.
    errors: of the recalibrated twin and of this stage's, by role and channel.
    twin: what is written as twin.toml in the repaired twin's place.
  """

  sentence: str = ""
  facts: Sequence[tuple[str, str]] = ()
  sections: Sequence[Section] = ()
  curves: Mapping[str, Any] | None = None
  twin: Written | None = None
  errors: Mapping[str, Mapping[str, ChannelFit]] = dataclasses.field(default_factory=dict)


NOTHING_FURTHER = Further()
