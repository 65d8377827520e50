"""What `pip install .` would install: every package with its data, and the command."""

import itertools
import shutil
import subprocess
import sys
import tomllib
import zipfile

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests import ROOT

PACKAGES = ("qcar_twin", "calibration", "agents", "assets", "scripts")
INSIDE = ("assets", "scripts")  # installed as parts of qcar_twin
SOURCES = (".py", ".c", ".h", ".xml", ".toml", ".yml", ".html", ".css", ".js", ".json", ".txt", ".onnx", ".safetensors")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
  """Built from a copy, so that nothing is left in the checkout; no network, no isolation."""
  folder = tmp_path_factory.mktemp("wheel")
  for package in PACKAGES:
    shutil.copytree(ROOT / package, folder / "source" / package, ignore=shutil.ignore_patterns("__pycache__", "_build"))
  for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
    shutil.copy(ROOT / name, folder / "source")
  command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index", "-w", folder]
  done = subprocess.run([*command, folder / "source"], capture_output=True, text=True, check=False)
  assert done.returncode == 0, done.stderr[-2000:]
  with zipfile.ZipFile(next(folder.glob("*.whl"))) as archive:
    yield archive


def test_every_source_and_every_file_of_data_is_in_it(wheel):
  packed = {name for name in wheel.namelist() if ".dist-info" not in name}
  wanted = {
    ("qcar_twin/" if package in INSIDE else "") + path.relative_to(ROOT).as_posix()
    for package in PACKAGES
    for path in (ROOT / package).rglob("*")
    if path.suffix in SOURCES and "_build" not in path.parts
  }
  assert packed == wanted
  assert {"agents/data/policy/policy.onnx", "qcar_twin/assets/qcar.xml", "qcar_twin/pages/page.html"} <= packed


def test_the_command_and_what_it_needs_are_declared(wheel):
  about = {name.rpartition("/")[2]: wheel.read(name).decode() for name in wheel.namelist() if ".dist-info" in name}
  assert "qcar-twin = qcar_twin.scripts.__main__:main" in about["entry_points.txt"]
  needed = [line for line in about["METADATA"].splitlines() if line.startswith("Requires-Dist") and "extra" not in line]
  assert len(needed) > 10 and any("mujoco==3.17.*" in line for line in needed)


def test_the_tested_versions_are_within_what_is_declared():
  lines = (ROOT / "requirements.lock").read_text(encoding="utf-8").splitlines()
  locked = dict(line.split("==") for line in lines if not line.startswith("#"))
  versions = {canonicalize_name(name): version for name, version in locked.items()}
  project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
  extras = project["optional-dependencies"]
  del extras["cluster"]  # installed by hand, on the computers of a cluster
  for requirement in map(Requirement, [*project["dependencies"], *itertools.chain(*extras.values())]):
    if requirement.name == project["name"]:
      assert requirement.extras <= set(extras)
    else:
      assert requirement.specifier.contains(versions[canonicalize_name(requirement.name)]), requirement
