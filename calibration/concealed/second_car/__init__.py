"""A second independent car, of another structure than the first, for tests of transfer: nothing is set on it.

A rigid chassis in space on four struts, LuGre tyres, a motor with inductance behind a bridge and a battery, three
differentials, an integrator with error control. Of the first car it shares manoeuvres, driver and what is written.
"""

from .car import SecondCar
from .effects import SECOND_EFFECTS, draw_second_effect
from .session import drawn_car, make_second_session

__all__ = ["SECOND_EFFECTS", "SecondCar", "draw_second_effect", "drawn_car", "make_second_session"]
