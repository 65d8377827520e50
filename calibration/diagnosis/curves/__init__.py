"""The twin with curves of no known form in its maps: what it reaches, and which named forms the curves have."""

from calibration.diagnosis.curves.flexible import Characterised, characterise
from calibration.diagnosis.curves.naming.forms import Form, Outline

__all__ = ["Characterised", "Form", "Outline", "characterise"]
