"""Pacejka's sine law: the force rises to a peak and falls a little beyond it.

Equation: g(rho) = sin(C atan(rho / C)) / rho.
Source: Pacejka, Tyre and Vehicle Dynamics, 3rd ed., 2012, ch. 4.
"""

from qcar_twin.parameters import Parameter

PARAMETERS = (Parameter("tyre_shape", 1.4, 1.0, 1.95, "-", "C", std=0.2),)  # 1 has no fall after the peak
