"""The rules of the house: rooms, directions, circles, sizes, words; read off the source or a fresh interpreter."""

import ast
import functools
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path

import pytest

from tests import ROOT

PACKAGES = ("qcar_twin", "calibration", "agents", "scripts")
PARENTS = {"qcar_twin", "calibration", "calibration.concealed"}
FILES = sorted(p for package in PACKAGES for p in (ROOT / package).rglob("*.py"))
FORBIDDEN_NAMES = re.compile(r"(^|_)(utils?|helpers?|manager|handler|data2)($|_)|_old$|^do_|\d{2,}_")
MOST_FILES = 16  # that a folder holds before it is several rooms; a registry of one kind of thing may hold more
REGISTRIES = ("qcar_twin/twin/mechanisms", "scripts")


def module_of(path: Path) -> str:
  """Dotted name of a file; a package's is its folder's."""
  return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_of(p): p for p in FILES}
FACES = sorted(m for m, p in MODULES.items() if p.name == "__init__.py")


@functools.cache
def walked(path: Path) -> tuple[frozenset[tuple[str, str]], tuple[str, ...]]:
  """(module, name) of all that a file imports, relative imports resolved, name "" for a module; its long functions."""
  package, names, long = path.relative_to(ROOT).parent.parts, set(), []
  for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
    if isinstance(node, ast.Import):
      names.update((alias.name, "") for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
      base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
      module = ".".join(part for part in (base, node.module or "") if part)
      names.update((module, alias.name) for alias in node.names)
    elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and node.end_lineno - node.lineno >= 60:
      long.append(node.name)
  return frozenset(names), tuple(long)


def imported_names(path: Path) -> frozenset[tuple[str, str]]:
  return walked(path)[0]


@functools.cache
def imports(path: Path) -> set[str]:
  """Absolute names of modules and of names in them that a file imports."""
  return {n for module, item in imported_names(path) for n in (module, f"{module}.{item}" if item else module)}


@functools.cache
def graph() -> dict[str, set[str]]:
  """Module -> modules of this project that it names in an import; a package's face counts as a module."""
  uses = {}
  for module, path in MODULES.items():
    used = {f"{m}.{n}" if f"{m}.{n}" in MODULES else m for m, n in imported_names(path)}
    uses[module] = {name for name in used if name in MODULES and name != module}
  return uses


def circles(edges: Mapping[str, set[str]]) -> list[list[str]]:
  """Groups of nodes that reach each other (strongly connected components of two and more)."""

  @functools.cache
  def reach(node: str) -> frozenset[str]:
    seen, todo = set(), [node]
    while todo:
      for other in edges.get(todo.pop(), set()) - seen:
        seen.add(other)
        todo.append(other)
    return frozenset(seen)

  groups = {frozenset(b for b in reach(a) if a in reach(b)) for a in edges}
  return sorted(sorted(group) for group in groups if len(group) > 1)


def outside(names: set[str]) -> set[str]:
  """Top-level packages beyond the standard library and this project."""
  return {n.split(".")[0] for n in names} - set(sys.stdlib_module_names) - set(PACKAGES)


@functools.cache
def really_loaded(statement: str) -> frozenset[str]:
  """Names of all modules that a statement brings into a fresh interpreter."""
  code = f"import sys; before = set(sys.modules); {statement}; print(' '.join(set(sys.modules) - before))"
  run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
  return frozenset(run.stdout.split())


def test_there_are_files_to_check():
  assert len(FILES) > 60


def test_a_circle_is_found():
  assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]


def test_no_file_imports_itself_back():
  assert circles(graph()) == []


def test_no_room_imports_itself_back():
  """Rooms are the folders below a package; what a folder holds belongs to it."""
  room = lambda module: ".".join(module.split(".")[:2])
  edges: dict[str, set[str]] = {}
  for module, used in graph().items():
    if module not in PACKAGES:
      edges.setdefault(room(module), set()).update(room(u) for u in used if room(u) != room(module))
  assert circles(edges) == []


def test_nothing_underscored_crosses_a_file():
  for path in FILES:
    crossing = [f"{m}.{n}" for m, n in imported_names(path) if m.split(".")[0] in PACKAGES and n.startswith("_")]
    assert not crossing, f"{path.relative_to(ROOT)} imports {crossing}"


def test_no_import_is_for_the_type_checker_alone():
  for path in FILES:
    assert "typing.TYPE_CHECKING" not in imports(path), path.relative_to(ROOT)


@pytest.mark.parametrize("folder", sorted({p.parent for p in FILES}), ids=lambda p: str(p.relative_to(ROOT)))
def test_a_folder_is_one_room(folder: Path):
  if folder.relative_to(ROOT).as_posix() not in REGISTRIES:
    assert len(list(folder.glob("*.py"))) - 1 <= MOST_FILES


@pytest.mark.parametrize("package", FACES)
def test_a_face_has_what_it_offers(package: str):
  face = import_module(package)
  for name in getattr(face, "__all__", ()):
    assert getattr(face, name) is not None
    assert not name.startswith("_")


@pytest.mark.parametrize(
  "statement",
  [
    "import qcar_twin.recordings",
    "from qcar_twin import DataSet",
    "import qcar_twin.parameters, qcar_twin.kinematics, qcar_twin.plant",
    "import qcar_twin.vehicle",
    "import qcar_twin.bicycle",
  ],
)
def test_numpy_is_all_that_is_really_loaded(statement: str):
  assert "numpy" in really_loaded(statement)
  assert outside(set(really_loaded(statement))) <= {"numpy"}


def test_the_proving_ground_never_loads_the_twin():
  loaded = really_loaded("import calibration.concealed.proving_ground")
  own = {name for name in loaded if name.split(".")[0] in PACKAGES}
  files = ("qcar_twin.recordings", "qcar_twin.atomic_io", "qcar_twin.extras", "qcar_twin.untrusted")  # no physics
  files += ("calibration.concealed.laboratory", "calibration.concealed.proving_ground")
  assert not {name for name in own - PARENTS if not name.startswith(files)}
  assert not {"mujoco", "torch", "sklearn"} & loaded


def test_the_second_car_never_loads_the_twin_or_the_first():
  loaded = really_loaded("import calibration.concealed.second_car, calibration.concealed.second_car.session")
  own = {name for name in loaded if name.split(".")[0] in PACKAGES}
  files = (
    "qcar_twin.recordings",
    "qcar_twin.atomic_io",
    "qcar_twin.extras",
    "qcar_twin.untrusted",
    "calibration.concealed.laboratory",
    "calibration.concealed.second_car",
  )
  assert not {name for name in own - PARENTS if not name.startswith(files)}
  assert not {"mujoco", "torch", "sklearn"} & loaded


def test_the_exam_never_loads_the_twin_and_nothing_but_its_commands_loads_the_exam():
  loaded = really_loaded("import calibration.concealed.exam.session, calibration.concealed.exam.cases")
  own = {name for name in loaded if name.split(".")[0] in PACKAGES}
  files = ("qcar_twin.recordings", "qcar_twin.atomic_io", "qcar_twin.untrusted", "qcar_twin.extras")
  files += ("calibration.concealed.laboratory", "calibration.concealed.exam")
  assert not {name for name in own - PARENTS if not name.startswith(files)}
  assert not {"mujoco", "torch", "sklearn", "slipx", "vehiclemodels", "exudyn"} & loaded
  rooms = ("calibration.concealed.exam", "calibration.concealed.examination")
  users = {module for module, used in graph().items() if any(u.startswith(rooms) for u in used)}
  exams = {f"scripts.{name}" for name in ("make_exam_session", "exam", "replay", "set_levels")}
  assert {u for u in users if not u.startswith(rooms)} == exams | {"calibration.concealed.benchmarks.known"}


def test_what_decides_reads_numbers_only():
  """No fit, no simulator, however far the imports of its files are followed; the faces of packages aside."""
  decides = {m for m in graph() if m.startswith("calibration.diagnosis.decision.")}
  seen, todo = set(decides), sorted(decides)
  while todo:
    new = {m for m in graph()[todo.pop()] if m not in FACES} - seen
    seen, todo = seen | new, [*todo, *new]
  files = {f"qcar_twin.{name}" for name in ("atomic_io", "extras", "untrusted")}
  assert decides and seen - decides <= {*files, "calibration.intervals.forms"}
  assert not {"mujoco"} & {n.split(".")[0] for m in seen for n in imports(MODULES[m])}


def test_the_laboratory_knows_no_car():
  for path in (ROOT / "calibration" / "concealed" / "laboratory").glob("*.py"):
    used = {
      n
      for n in imports(path)
      if n.startswith(("calibration.concealed.proving_ground", "calibration.concealed.second_car"))
    }
    assert not used, path.name


def test_a_mechanism_never_imports_another():
  folder = ROOT / "qcar_twin" / "twin" / "mechanisms"
  shared = {"base", "by_motion", "elements", "document", "__init__"}
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
    ("agents", ("calibration", "scripts")),
    ("qcar_twin", ("calibration", "agents", "scripts")),
    ("qcar_twin/estimation", ("mujoco", "qcar_twin.twin")),
    ("calibration", ("scripts", "agents")),
    ("scripts", ("scripts",)),  # installed as qcar_twin.scripts, run as a file too: the name is not there
    ("calibration/fitting", ("calibration.diagnosis", "calibration.cross_validation", "calibration.identification")),
    ("calibration/diagnosis", ("calibration.cross_validation", "calibration.concealed")),
  ],
)
def test_directions(package: str, banned: tuple[str, ...]):
  for path in (ROOT / package).rglob("*.py"):
    used = {n for n in imports(path) if any(n == b or n.startswith(b + ".") for b in banned)}
    assert not used, f"{path.relative_to(ROOT)} imports {used}"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_sizes_and_words(path: Path):
  text = path.read_text(encoding="utf-8")
  assert text.count("\n") <= 350, "a file of more than 350 lines is two rooms"
  assert not FORBIDDEN_NAMES.search(path.stem), "a name that says nothing"
  assert not walked(path)[1], "too long to read at once"
  assert not re.search(  # an attribute's spelling is that of the package that has it
    r"(?<!\.)\btires?\b|\bbehavior|\bcolor(?!map|bar|s?=|s?\b\s*[=:\[\"')])", re.sub(r"[\w.]*color\w*", "", text)
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


def test_commands_are_thin():
  for path in (ROOT / "scripts").glob("*.py"):
    assert path.read_text().count("\n") <= 100 + 5, path.name  # five run the file by itself


def test_no_pickle_and_no_absolute_paths():
  for path in FILES:
    text = path.read_text(encoding="utf-8")
    assert "pickle" not in imports(path), path.name
    assert not re.search(r"[\"'](/work|/tmp|/root|/home)/", text), path.name


TALE = re.compile(
  r"\b(single|pair|null|outside)_\d\d\b|\b(seed|campaign)s? \d{5,}"  # a case, a campaign
  r"|\b(?=[0-9a-f]*\d)(?=[0-9a-f]*[a-f])[0-9a-f]{7,40}\b(?![.-])"  # a commit
)
PAGES = sorted((ROOT / "docs").rglob("*.md"))
WRITTEN = [p for p in PAGES if p.parent.name in ("guide", "reference") and p.name not in ("api.md", "mechanisms.md")]
TOLD = [*FILES, ROOT / "README.md", *WRITTEN]  # what says what is, and not how it came to be
SCREENS, LINES, COLUMNS = 4, 50, 120  # that a page of the documents fits on
LYING = {
  p.relative_to(ROOT).as_posix() for top in (*PACKAGES, "tests", "docs", "data") for p in (ROOT / top).rglob("*")
}


def is_there(dotted: str) -> bool:
  """Whether a module, or a name of one or of a package's face, exists: `qcar_twin.vehicle.tyre.build`."""
  whole, parent, name = dotted.replace(".", "/"), *dotted.replace(".", "/").rsplit("/", 1)
  face = ROOT / parent / "__init__.py"
  offered = face.exists() and name in face.read_text(encoding="utf-8")
  return whole in LYING or f"{whole}.py" in LYING or f"{parent}.py" in LYING or offered


def named_paths(page: Path) -> Iterator[tuple[str, bool]]:
  """Paths that a page names, and whether each exists: its links, files, folders and modules in backticks."""
  text = page.read_text(encoding="utf-8")
  for link in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
    if "://" not in link:
      yield link, (page.parent / link).exists()
  for word in re.findall(r"[\w./-]+", " ".join(re.findall(r"`([^`\n]+)`", text))):
    if "/_build/" in word:  # made on the machine
      continue
    if "/" in word and word.split("/")[0] in (*PACKAGES, "tests", "docs"):
      yield word, (ROOT / word.rstrip("./")).exists()
    elif re.fullmatch(r"[\w/]+\.(py|c)", word):
      yield word, any(f"/{path}".endswith(f"/{word}") for path in LYING)
    elif re.fullmatch(rf"({'|'.join(PACKAGES)}|tests)(\.[a-z_]+)+", word):
      yield word, is_there(word)


@pytest.mark.parametrize("path", TOLD, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_case_no_seed_and_no_commit_is_told(path: Path):
  tale = TALE.search(path.read_text(encoding="utf-8"))
  assert not tale, f"{tale} belongs into docs/history/; say why in terms of mechanism"


def test_a_tale_is_noticed():
  assert all(map(TALE.search, ("as in single_07", "seed 6626070 had", "since af878d2, it")))
  assert not any(map(TALE.search, ("null_rate", "seed 7", "6626070", "effaced", "single_track", "1e-05")))


@pytest.mark.parametrize("page", WRITTEN, ids=lambda p: p.name)
def test_a_page_fits_on_four_screens(page: Path):
  lines = page.read_text(encoding="utf-8").splitlines()
  assert sum(max(1, -(-len(line) // COLUMNS)) for line in lines) <= SCREENS * LINES


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda p: p.name)
def test_what_a_page_names_exists(page: Path):
  # the history tells of files that are gone, the pages on extending of files that a reader writes
  if page.parent.name != "history" and not page.name.startswith("extending"):
    assert not [name for name, there in named_paths(page) if not there]


@pytest.mark.parametrize("page", [*WRITTEN, ROOT / "README.md"], ids=lambda p: p.name)
def test_what_a_page_imports_is_offered(page: Path):
  text = page.read_text(encoding="utf-8")
  for module, names in re.findall(r"^\s*from ([\w.]+) import ([\w, ]+)$", text, re.M):
    if module.split(".")[0] in PACKAGES:
      assert all(hasattr(import_module(module), name.strip()) for name in names.split(",")), f"{module}: {names}"
