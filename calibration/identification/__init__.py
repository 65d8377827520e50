"""The paper's identification of the bicycle, and the twin matched to it."""

from calibration.identification.drive_fit import NotIdentifiable
from calibration.identification.identification import Identification, identify
from calibration.identification.match_bicycle import match_bicycle

__all__ = ["Identification", "NotIdentifiable", "identify", "match_bicycle"]
