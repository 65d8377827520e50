"""A car as numbers (`Vehicle`), as a MuJoCo model (`mjcf`), and its tyres."""

from qcar_twin.vehicle.drive import DRIVES, Drive
from qcar_twin.vehicle.vehicle import GRAVITY, QCAR, WHEELS, Vehicle

__all__ = ["DRIVES", "Drive", "GRAVITY", "QCAR", "Vehicle", "WHEELS"]
