"""Which packages are installed: the rooms as they lie, with `assets` and `scripts` as parts of `qcar_twin`."""

from setuptools import find_packages, setup

ROOMS = ("qcar_twin*", "calibration*", "agents*")
INSIDE = {"qcar_twin.assets": "assets", "qcar_twin.scripts": "scripts"}  # names too general to install at the top

setup(packages=[*find_packages(include=ROOMS), *INSIDE], package_dir={"": ".", **INSIDE})
