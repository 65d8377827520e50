"""The physics twin: a MuJoCo car with mechanisms in slots, its parameters, its file."""

from qcar_twin.twin.file import load_twin, save_twin
from qcar_twin.twin.parameters import base_parameters
from qcar_twin.twin.twin import Simulation, Twin

__all__ = ["Simulation", "Twin", "base_parameters", "load_twin", "save_twin"]
