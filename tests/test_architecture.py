"""The rules of the house, checked on the source: directions, sizes, words."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("qcar_twin", "calibration", "agents", "scripts")
FILES = sorted(p for package in PACKAGES for p in (ROOT / package).rglob("*.py"))
NUMPY_ONLY = ("parameters.py", "kinematics.py", "recording.py")
FORBIDDEN_NAMES = re.compile(r"(^|_)(utils?|helpers?|manager|handler|data2)($|_)|_old$|^do_|\d{2,}_")


def imports(path: Path) -> set[str]:
  """Absolute names of modules a file imports, relative imports resolved."""
  package = path.relative_to(ROOT).parent.parts
  found = set()
  for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
    if isinstance(node, ast.Import):
      found |= {alias.name for alias in node.names}
    elif isinstance(node, ast.ImportFrom):
      base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
      module = ".".join(part for part in (base, node.module or "") if part)
      found |= {module} | {f"{module}.{alias.name}" for alias in node.names}
  return found


def outside(names: set[str]) -> set[str]:
  """Top-level packages beyond the standard library and this project."""
  import sys

  return {n.split(".")[0] for n in names} - set(sys.stdlib_module_names) - set(PACKAGES)


def test_there_are_files_to_check():
  assert len(FILES) > 60


@pytest.mark.parametrize("name", NUMPY_ONLY)
def test_the_core_needs_numpy_only(name: str):
  assert outside(imports(ROOT / "qcar_twin" / name)) <= {"numpy"}


def test_a_mechanism_never_imports_another():
  folder = ROOT / "qcar_twin" / "mechanisms"
  shared = {"base", "elements", "document", "__init__"}
  mechanisms = {p.stem for p in folder.glob("*.py")} - shared
  for path in folder.glob("*.py"):
    if path.stem in shared:
      continue
    names = imports(path)
    assert outside(names) <= {"numpy"}, path.name
    assert not {n for n in names if n.split(".")[-1] in mechanisms and "mechanisms" in n}, path.name


@pytest.mark.parametrize(
  ("package", "banned"),
  [
    ("qcar_twin/estimation", ("mujoco",)),
    ("agents", ("calibration", "scripts")),
    ("qcar_twin", ("calibration", "agents", "scripts")),
    ("calibration", ("scripts", "agents")),
  ],
)
def test_directions(package: str, banned: tuple[str, ...]):
  for path in (ROOT / package).rglob("*.py"):
    tops = {n.split(".")[0] for n in imports(path)}
    assert not tops & set(banned), f"{path.relative_to(ROOT)} imports {tops & set(banned)}"


def test_the_proving_ground_shares_nothing_with_the_twin():
  # files, no physics
  allowed = {"qcar_twin", "qcar_twin.recording", "qcar_twin.dataset", "qcar_twin.whole_file"}
  for path in (ROOT / "calibration" / "proving_ground").rglob("*.py"):
    for name in imports(path):
      if name.startswith("qcar_twin"):
        assert ".".join(name.split(".")[:2]) in allowed, f"{path.name} imports {name}"
      if name.startswith("calibration."):
        assert name.startswith("calibration.proving_ground"), f"{path.name} imports {name}"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_sizes_and_words(path: Path):
  text = path.read_text(encoding="utf-8")
  assert text.count("\n") <= 350, "a file of more than 350 lines is two rooms"
  assert not FORBIDDEN_NAMES.search(path.stem), "a name that says nothing"
  for node in ast.walk(ast.parse(text)):
    if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
      assert node.end_lineno - node.lineno < 60, f"{node.name} is too long to read at once"
  assert not re.search(
    r"\btires?\b|\bbehavior|\bcolor(?!map|bar|s?=|s?\b\s*[=:\[\"')])", re.sub(r"[\w.]*color\w*", "", text)
  )


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_public_functions_are_typed_and_said(path: Path):
  tree = ast.parse(path.read_text(encoding="utf-8"))
  assert ast.get_docstring(tree), "a module says what it is for"
  for node in tree.body:
    if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
      assert node.returns is not None, f"{node.name} has no return type"
      untyped = [a.arg for a in node.args.args if a.annotation is None]
      assert not untyped, f"{node.name}: {untyped} have no type"


def test_scripts_are_thin():
  for path in (ROOT / "scripts").glob("*.py"):
    assert path.read_text().count("\n") <= 100, path.name


def test_no_pickle_and_no_absolute_paths():
  for path in FILES:
    text = path.read_text(encoding="utf-8")
    assert "pickle" not in imports(path), path.name
    assert not re.search(r"[\"'](/work|/tmp|/root|/home)/", text), path.name
