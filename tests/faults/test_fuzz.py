"""Every reader ends in a finite result or in an error that names the file, whatever the file; in small."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.twin.file import load_twin
from qcar_twin.untrusted import UnreadableFile, read_json, read_toml
from tests.faults.bombs import BOMBS, HEAVY
from tests.faults.fuzz import CLEAR, RIGHT, apart, fuzz
from tests.faults.samples import KINDS
from tests.qcar_twin.recordings.drives import drive, folder_with

VALUES = st.one_of(
  st.integers(), st.floats(), st.booleans(), st.text(max_size=20), st.just(10**400),
  st.lists(st.integers(), max_size=3), st.dictionaries(st.text(max_size=3), st.integers(), max_size=2), st.dates(),
)  # fmt: skip
WORDS = st.text(st.characters(codec="utf-8"), max_size=60)
FEW = settings(max_examples=100, derandomize=True, deadline=None,
               suppress_health_check=[HealthCheck.function_scoped_fixture])  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_ends_in_a_clear_error_or_a_result(kind, tmp_path):
  outcomes = dict(fuzz(kind, 50, 7, tmp_path))
  faults = {seed: outcome for seed, outcome in outcomes.items() if outcome.fault}
  assert not faults
  assert sum(outcome.end == CLEAR for outcome in outcomes.values()) > 20


@pytest.mark.parametrize("name", [name for name in BOMBS if name not in HEAVY])
def test_a_file_made_to_do_harm_does_none(name, tmp_path, monkeypatch):
  _harmless(name, tmp_path, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("name", HEAVY)
def test_a_file_that_unpacks_to_gigabytes_is_refused(name, tmp_path, monkeypatch):
  assert _harmless(name, tmp_path, monkeypatch) == CLEAR


def _harmless(name: str, tmp_path: Path, monkeypatch) -> str:
  kind, write = BOMBS[name]
  for place in ("data", "cwd"):
    (tmp_path / place).mkdir()
  monkeypatch.chdir(tmp_path / "cwd")
  KINDS[kind].make(tmp_path / "data")
  write(tmp_path / "data")
  names = tuple(path.stem for path in (tmp_path / "data").rglob("*"))
  outcome = apart(lambda: KINDS[kind].read(tmp_path / "data"), names)
  assert not outcome.fault, outcome
  assert not list(tmp_path.rglob("*cracked*")), "something in it was executed, or written outside"
  return outcome.end


def toml(value: object) -> str:
  """A value as TOML has it; text with every character escaped."""
  if isinstance(value, dict):
    return "{" + ", ".join(f"{toml(str(key))} = {toml(item)}" for key, item in value.items()) + "}"
  if isinstance(value, list):
    return "[" + ", ".join(map(toml, value)) + "]"
  if isinstance(value, str):
    return '"' + "".join(f"\\U{ord(mark):08x}" for mark in value if not 0xD800 <= ord(mark) < 0xE000) + '"'
  return str(value).lower() if isinstance(value, (bool, float)) else str(value)


@FEW
@given(value=VALUES, place=st.sampled_from(["name = {}", "[vehicle]\nmass = {}", "[vehicle.std]\nmass = {}",
  "vehicle = {}", "channels = {}", "recording = {}", "[channels]\nspeed = {}", "[channels.speed]\ncolumn = {}",
  "[channels.speed]\ncolumn = 'a'\nscale = {}", "[[recording]]\nfile = {}",
  "[[recording]]\nfile = 'run.csv'\nrole = {}",
  "[[recording]]\nfile = 'run.csv'\nrole = 'identify'\nfrom = {}",
  "[[recording]]\nfile = 'run.csv'\nrole = 'identify'\nname = {}"]))  # fmt: skip
def test_any_value_in_dataset_toml_is_understood_or_refused(tmp_path, value, place):
  if not (tmp_path / "run.csv").is_file():
    folder_with(tmp_path, *drive(1.0))
  rest = "" if "recording" in place else "\n[[recording]]\nfile = 'run.csv'\nrole = 'identify'\n"
  (tmp_path / "dataset.toml").write_text(place.format(toml(value)) + rest, encoding="utf-8")
  try:
    assert DataSet.load(tmp_path).recordings
  except RecordingError as error:
    assert "\n" not in str(error) or "\n" in str(value)


@pytest.fixture(scope="module")
def good_twin(tmp_path_factory) -> tuple[Path, str]:
  folder = tmp_path_factory.mktemp("twin")
  KINDS["twin.toml"].make(folder)
  return folder / "twin.toml", (folder / "twin.toml").read_text(encoding="utf-8")


@FEW
@given(value=VALUES, line=st.integers(0, 70))
def test_any_value_in_a_twin_file_is_understood_or_refused(good_twin, value, line):
  file, text = good_twin
  lines = text.splitlines()
  key = lines[line % len(lines)].partition(" = ")[0]
  lines[line % len(lines)] = f"{key} = {toml(value)}"
  file.write_text("\n".join(lines), encoding="utf-8")
  try:
    twin, theta = load_twin(file, threads=1)
    assert len(twin.parameters) == len(theta)
  except UnreadableFile as error:
    assert "twin.toml" in str(error)


@FEW
@given(text=WORDS)
def test_any_text_is_toml_and_json_or_an_error_that_names_the_file(tmp_path, text):
  (tmp_path / "a.txt").write_bytes(text.encode("utf-8", errors="replace"))
  for read in (read_toml, read_json):
    try:
      assert isinstance(read(tmp_path / "a.txt"), dict)
    except UnreadableFile as error:
      assert "a.txt" in str(error)


def test_the_fuzz_sees_what_is_wrong():
  """What it would say of readers that break the promise."""

  def spill() -> object:
    raise ZeroDivisionError

  def refuse() -> object:
    raise UnreadableFile("a.csv: damaged; write it again")

  assert apart(spill, ("a",)).fault and apart(lambda: [float("nan")], ("a",)).fault
  assert apart(refuse, ("b",)).fault and apart(refuse, ("a",)).end == CLEAR
  assert apart(lambda: 1.0, ("a",)).end == RIGHT
  assert apart(lambda: bytearray(b"x" * (2200 << 20)) and 1.0, ("a",)).fault
  assert "SIGKILL" in apart(lambda: __import__("os").kill(__import__("os").getpid(), 9), ("a",)).end
