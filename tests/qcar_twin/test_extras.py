"""A plain installation diagnoses CSV files; what more a use needs is an extra, named by its error."""

import ast
import functools
import re
import subprocess
import sys
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from qcar_twin.extras import EXTRA_OF, MissingExtra, extra
from tests import ROOT

ROOMS = ("qcar_twin", "calibration", "agents", "scripts")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PACKAGES = {
  "dm_env": "dm_control",
  "matio": "mat-io",
  "mcap_protobuf": "mcap-protobuf-support",
  "ruamel": "ruamel.yaml",
  "sklearn": "scikit-learn",
}  # by import
# made unimportable, all at once: what a plain installation does not have
WITHOUT = f"""
import importlib.abc, sys
asked = []
class Absent(importlib.abc.MetaPathFinder):
  def find_spec(self, name, path=None, target=None):
    if name.partition(".")[0] in {set(EXTRA_OF)!r}:
      asked.append(name)
      raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
"""


def in_python(code: str) -> str:
  """What a new process prints that has only the packages of a plain installation."""
  done = subprocess.run([sys.executable, "-c", WITHOUT + code], capture_output=True, text=True, check=False, cwd=ROOT)
  assert done.returncode == 0, done.stderr[-2000:]
  return done.stdout


IMPORT = re.compile(r"(?m)^\s*(?:from (\w+)[\w.]* import |import (\w+))")


@functools.cache
def sources() -> dict[str, tuple[str, frozenset[str]]]:
  """Text of every module of the project, by its file, and the packages that it imports, at its top or later."""
  files = [path for room in ROOMS for path in (ROOT / room).rglob("*.py")]
  texts = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in files}
  return {file: (text, frozenset(a or b for a, b in IMPORT.findall(text))) for file, text in texts.items()}


def distributions(requirements: list[str]) -> set[str]:
  return {canonicalize_name(Requirement(text).name) for text in requirements}


def test_a_plain_installation_has_all_that_diagnosing_a_csv_imports():
  """Nothing of an extra is even looked for, so none is loaded where it is installed."""
  printed = in_python("""
import qcar_twin, calibration, agents
import scripts.diagnose, scripts.run, scripts.check, scripts.new, scripts.estimate, scripts.track
from pathlib import Path
from qcar_twin.recordings.dataset import DataSet
print(len(DataSet.load(Path("data/sample")).recordings), asked)""")
  assert printed == f"{(ROOT / 'data/sample/dataset.toml').read_text().count('[[recording]]')} []\n"


# of a file that is written for users, who may have it: calibration/exports/single_track.py
LEFT = {"casadi"}


def test_every_imported_package_is_declared_where_the_table_says():
  declared = {name: distributions(texts) for name, texts in PROJECT["optional-dependencies"].items()}
  plain = distributions(PROJECT["dependencies"])
  used = set().union(*(names for _, names in sources().values())) - set(sys.stdlib_module_names) - set(ROOMS) - LEFT
  assert {"mujoco", "torch", "rosbags"} <= used
  for name in used:
    distribution = canonicalize_name(PACKAGES.get(name, name))
    assert distribution in (declared[EXTRA_OF[name]] if name in EXTRA_OF else plain), name
  assert not plain & {canonicalize_name(name) for name in EXTRA_OF}


def test_every_import_of_an_extra_stands_in_a_block_that_names_its_use():
  for file, (text, names) in sources().items():
    if not names & set(EXTRA_OF):
      continue
    tree = ast.parse(text)
    blocks = [node for node in ast.walk(tree) if isinstance(node, ast.With) and "extra(" in ast.unparse(node.items[0])]
    named = {id(node) for block in blocks for node in ast.walk(block)}
    bare = [
      node.lineno
      for node in ast.walk(tree)
      if isinstance(node, ast.Import | ast.ImportFrom)
      and set(EXTRA_OF) & {a or b for a, b in IMPORT.findall(ast.unparse(node))}
      and id(node) not in named
    ]
    assert not bare, f"{file}: line {bare}"


def test_the_error_names_the_use_and_its_extra(tmp_path):
  uses = {
    "import agents.learning.train": "Training needs the extra 'learn': pip install 'qcar-twin[learn]'",
    "import agents.learning.environments": "The gymnasium environment needs the extra 'environments'",
    "import qcar_twin.envs.dm_env": "The dm_control environment needs the extra 'environments'",
    "import qcar_twin.recordings.mcap_writer": "Writing MCAP files needs the extra 'logs'",
    "from qcar_twin.rendering.film import write_still; write_still(None, None)": "Writing a picture needs the extra 'f",
    "from qcar_twin.parallel import in_order; in_order([], ray=True)": "A Ray cluster needs the extra 'cluster'",
    f"read_table(Path({str(tmp_path)!r}, 'a.mcap'))": "a.mcap: Reading ROS bags and MCAP files needs the extra 'logs'",
    f"read_table(Path({str(tmp_path)!r}, 'a.bag'))": "a.bag: Reading ROS bags and MCAP files needs the extra 'logs'",
  }
  for name in ("a.mcap", "a.bag"):
    (tmp_path / name).write_bytes(b"MCAP")
  printed = in_python(f"""
from pathlib import Path
from qcar_twin.recordings.formats import read_table
for use in {list(uses)!r}:
  try:
    exec(use)
  except Exception as error:
    print(type(error).__name__, error)""")
  for line, said in zip(printed.splitlines(), uses.values(), strict=True):
    kind, _, text = line.partition(" ")
    assert kind in ("MissingExtra", "RecordingError") and text.startswith(said), line


def test_an_import_error_of_another_kind_is_left_as_it_is():
  with pytest.raises(ModuleNotFoundError) as error, extra("Reading"):
    import no_such_package  # noqa: F401  # pyright: ignore[reportMissingImports]
  assert not isinstance(error.value, MissingExtra)
