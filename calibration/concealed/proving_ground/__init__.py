"""The proving ground: an independent simulated car, its recordings, concealed effects, and the sealed truth."""

from ..laboratory.written import Session
from .car import Car
from .effects import EFFECTS
from .plant import ProvingGroundPlant
from .session import Spec, make_session, make_sessions

__all__ = ["EFFECTS", "Car", "ProvingGroundPlant", "Session", "Spec", "make_session", "make_sessions"]
