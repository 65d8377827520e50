"""Formulas: a force, angle or reading without a name, written in a closed set of variables and operations."""

from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.law import Law, Term
from qcar_twin.twin.formula.mechanism import Formula
from qcar_twin.twin.formula.table import Table

__all__ = ["DEGREES", "Formula", "Law", "Table", "Term"]
