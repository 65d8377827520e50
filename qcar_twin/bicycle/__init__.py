"""The simple model everybody compares with: the identified bicycle and its single track."""

from qcar_twin.bicycle.bicycle import PARAMETERS, Bicycle
from qcar_twin.bicycle.single_track import SingleTrackCar

__all__ = ["Bicycle", "PARAMETERS", "SingleTrackCar"]
