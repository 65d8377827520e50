"""The environment as somebody has it who installed the package: in a process of its own, away from the sources."""

import os
import shutil
import subprocess
import sys

import pytest

from tests import ROOT

SOURCES = (
  "pyproject.toml",
  "setup.py",
  "README.md",
  "LICENSE",
  "qcar_twin",
  "calibration",
  "agents",
  "assets",
  "scripts",
)
NAME = "QcarTwin/PathTracking-v1"
MODULE = f"agents.learning.environments:{NAME}"
DRIVE = """
import gymnasium, numpy, sys
name, folder = sys.argv[1:]
env = gymnasium.make(name, plant="bicycle", path="o")
seen, _ = env.reset(seed=0)
assert env.observation_space.contains(seen)
env.step(numpy.zeros(1, numpy.float32))
cars = gymnasium.make_vec(name, num_envs=3, plant="bicycle")
cars.reset(seed=0)
assert cars.step(numpy.zeros((3, 1), numpy.float32))[0].shape == (3, 9)
import agents.learning.environments as where
from agents.learning.policy_file import SHIPPED, load_policy
from agents.learning.hyperparameters import ALGORITHMS, read_hyperparameters
load_policy(SHIPPED)
assert all(read_hyperparameters(name).env_kwargs for name in ALGORITHMS)
assert where.__file__.startswith(folder), where.__file__
print("driven")
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
  """A folder of packages made by `pip install` of a copy of the sources."""
  sources, target = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("installed")
  for name in SOURCES:
    if (ROOT / name).is_dir():
      shutil.copytree(ROOT / name, sources / name, ignore=shutil.ignore_patterns("__pycache__", "*.so", "*.egg-info"))
    else:
      shutil.copy(ROOT / name, sources)
  pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--no-build-isolation"]
  made = subprocess.run(
    [*pip, "--no-compile", "--target", target, sources], capture_output=True, text=True, check=False
  )
  assert made.returncode == 0, made.stderr[-2000:]
  return target


def fresh(packages, cwd, *command):
  """A Python that finds `packages` first, started in another folder."""
  environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, packages)), "OMP_NUM_THREADS": "1"}
  return subprocess.run(
    [sys.executable, "-c", *map(str, command)], cwd=cwd, env=environment, capture_output=True, text=True, check=False
  )


def test_a_fresh_process_makes_the_environment_and_its_batch_by_name(installed, tmp_path):
  done = fresh([installed], tmp_path, DRIVE, MODULE, installed)
  assert done.returncode == 0 and done.stdout.split() == ["driven"], done.stderr[-2000:]


def test_the_name_alone_is_not_found_since_gymnasium_reads_no_entry_points(installed, tmp_path):
  """Should a release read the group `gymnasium.envs`, this fails: declare the entry point in pyproject.toml then."""
  declared = tmp_path / "declared" / "declared-1.dist-info"
  declared.mkdir(parents=True)
  (declared / "METADATA").write_text("Metadata-Version: 2.1\nName: declared\nVersion: 1\n", encoding="utf-8")
  group = "[gymnasium.envs]\nQcarTwin = agents.learning.environments:register\n"
  (declared / "entry_points.txt").write_text(group, encoding="utf-8")
  packages = [installed, declared.parent]
  known = "from importlib.metadata import entry_points as e; print([p.name for p in e(group='gymnasium.envs')])"
  assert "QcarTwin" in fresh(packages, tmp_path, known).stdout
  done = fresh(packages, tmp_path, DRIVE, NAME, installed)
  assert done.returncode != 0 and "NamespaceNotFound" in done.stderr, done.stderr[-2000:]
