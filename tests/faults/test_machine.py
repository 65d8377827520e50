"""A full disk, a folder that cannot be written, no compiler, no OpenGL: one sentence with the cure, no traceback."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from qcar_twin.atomic_io import whole_file, write_text
from qcar_twin.cures import cure
from tests import ROOT
from tests.scripts.tiny_session import write


def said(words: list[str], limit: int | None = None, **environment: str) -> str:
  """What a command that fails says on its last line; nothing of it may be a traceback."""
  bound = None if limit is None else lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
  # Python keeps bytecode that could be written only in part, and every later process would stumble over it
  unwritten = {} if limit is None else {"PYTHONDONTWRITEBYTECODE": "1"}
  done = subprocess.run(
    [sys.executable, "-m", "scripts", *words],
    capture_output=True,
    text=True,
    cwd=ROOT,
    env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"} | unwritten | environment,
    preexec_fn=bound,
    check=False,
  )
  assert done.returncode == 1, done.stderr[-2000:]
  assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr, done.stderr[-2000:]
  return next(line for line in reversed(done.stderr.splitlines()) if "qcar-twin " in line)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
  folder = tmp_path_factory.mktemp("machine") / "data"
  write(folder)
  return folder


def results(folder: Path) -> list[str]:
  return sorted(path.name for path in folder.rglob("*") if path.is_file())


@pytest.mark.slow
@pytest.mark.parametrize(
  ("limit", "words"),
  [(1000, "check --dataset {data} --out {out}"), (1000, "make-session --quick --out {out}"),
   (60_000, "train --quick --out {out}"), (1000, "render --quick --out {out}/film.mp4")],
)  # fmt: skip
def test_a_file_that_cannot_grow_is_said_and_nothing_half_is_left(limit, words, data, tmp_path):
  line = said(words.format(data=data, out=tmp_path / "out").split(), limit)
  assert str(tmp_path) in line and "File too large; files may not grow that large here" in line
  left = [path for path in (tmp_path / "out").rglob("*") if path.is_file() and "events.out" not in path.name]
  assert all(path.stat().st_size < limit for path in left) and "arrays.npz" not in results(tmp_path)
  assert not list(tmp_path.rglob(".writing-*"))


@pytest.mark.parametrize("content", [b"x" * 40_000, b"x"])
def test_a_full_disk_is_named_and_what_was_there_stays(tmp_path, content):
  if os.geteuid() != 0:
    pytest.skip("only the owner of the machine can mount a small disk")
  small = tmp_path / "small"
  small.mkdir()
  if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", small], check=False).returncode:
    pytest.skip("no disk may be mounted here")
  try:
    file = write_text(small / "page.md", "old")
    with pytest.raises(OSError, match="No space left") as caught, whole_file(file) as part:
      part.write_bytes(content)
      part.with_name("more").write_bytes(bytes(100_000))
    assert str(small) in str(cure(caught.value)) and "free some space" in str(cure(caught.value))
    assert file.read_text() == "old" and results(small) == ["page.md"]
  finally:
    subprocess.run(["umount", small], check=True)


def test_a_librarys_own_error_on_a_full_disk_is_the_same(tmp_path):
  with pytest.raises(OSError, match="No space left") as caught, whole_file(tmp_path / "a.safetensors"):
    raise RuntimeError("I/O error: No space left on device (os error 28)")
  assert str(tmp_path) in str(cure(caught.value)) and not list(tmp_path.iterdir())


def test_an_error_that_is_not_the_disks_stays_what_it_is(tmp_path):
  with pytest.raises(ZeroDivisionError), whole_file(tmp_path / "a.txt"):
    raise ZeroDivisionError
  assert cure(ZeroDivisionError()) is None


def test_a_file_where_the_folder_should_be_is_said(data, tmp_path):
  """Refused to the owner of the machine as well, whom read-only modes do not stop."""
  (tmp_path / "out").touch()
  line = said(["check", "--dataset", str(data), "--out", str(tmp_path / "out")])
  assert str(tmp_path / "out") in line and "a file is where a folder has to be; name another folder" in line


@pytest.mark.parametrize("out", ["taken.csv", "taken.csv/deeper"])
def test_a_file_of_any_name_in_the_folders_place_is_said_before_the_work(data, tmp_path, out):
  (tmp_path / "taken.csv").touch()
  line = said(["check", "--dataset", str(data), "--out", str(tmp_path / out)])
  assert "taken.csv: Not a directory" in line and "stage" not in line and not (tmp_path / "taken.csv").stat().st_size


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="this system has no /proc")
def test_a_place_that_takes_no_folders_is_said(data):
  line = said(["check", "--dataset", str(data), "--out", "/proc/out/check"])
  assert "/proc/out/check: cannot be made, as /proc takes no folders; name another folder" in line


def test_a_read_only_folder_is_said(data, tmp_path):
  if os.geteuid() == 0:
    pytest.skip("read-only modes do not stop the owner of the machine")
  tmp_path.chmod(0o500)
  line = said(["check", "--dataset", str(data), "--out", str(tmp_path / "out")])
  assert str(tmp_path / "out") in line and "name a folder that you may write to" in line


def test_no_opengl_is_said_with_what_to_install(tmp_path):
  line = said(["render", "--quick", "--out", str(tmp_path / "film.mp4")], MUJOCO_GL="osmesa", PYOPENGL_PLATFORM="none")
  assert "OpenGL" in line and "libosmesa6" in line


def test_an_error_inside_mujocos_opengl_says_what_to_install():
  """MuJoCo looks for what MUJOCO_GL names while it is imported, and fails there in whatever way PyOpenGL does."""
  code = compile("None.glGetError", "site-packages/OpenGL/platform/osmesa.py", "exec")
  with pytest.raises(AttributeError) as caught:
    exec(code)
  assert "unset MUJOCO_GL, or install it: on Debian libegl1 for egl, libosmesa6" in str(cure(caught.value))


COMPILED = """
import sys
from qcar_twin import native
native.shutil.which = lambda name: None
native.importlib.util.find_spec = lambda name: None
native.place_for = lambda source, name: __import__("pathlib").Path(sys.argv[1]) / name
from qcar_twin.vehicle.tyre import build
build.native = native
from scripts.__main__ import main
raise SystemExit(main(["track", "--quick", "--out", sys.argv[1] + "/out"]))
"""


def test_no_compiler_is_said_with_what_to_install(tmp_path):
  environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
  environment.pop("CC", None)
  done = subprocess.run(
    [sys.executable, "-c", COMPILED, str(tmp_path)],
    capture_output=True,
    text=True,
    cwd=ROOT,
    env=environment,
    check=False,
  )
  assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr[-2000:]
  assert "no compiler was found" in done.stderr and "install a C compiler, or `pip install ziglang`" in done.stderr
