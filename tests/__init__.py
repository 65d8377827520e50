"""Tests, in the rooms of what they test; where the project and the recordings of real cars lie."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
REAL = ROOT.parent / "shared" / "data"  # recordings of real cars, which lie beside the project
