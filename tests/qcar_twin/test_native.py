"""C parts are built by whatever compiler there is, never half, and lie where they can be written."""

import functools
import sys

import pytest

from qcar_twin import native

SOURCE = "int answer(void) { return ANSWER; }\n"


@pytest.fixture
def source(tmp_path):
  path = tmp_path / "installed" / "part.c"
  path.parent.mkdir()
  path.write_text('#include "answer.h"\n' + SOURCE)
  return path


def compiled(compiler, source, target, flags=()):
  native.compile_library(compiler, (*native.FLAGS, *flags), source, target, {"answer.h": "#define ANSWER 42\n"})


def test_without_a_system_compiler_the_wheel_is_used(monkeypatch):
  monkeypatch.delenv("CC", raising=False)
  monkeypatch.setattr(native.shutil, "which", lambda name: None)
  assert native.compilers() == [[sys.executable, "-m", "ziglang", "cc"]]


def test_a_chosen_compiler_comes_first(monkeypatch):
  monkeypatch.setenv("CC", "my-cc -m64")
  assert native.compilers()[0] == ["my-cc", "-m64"]


def test_a_failing_compiler_leaves_nothing_and_says_why(source, tmp_path):
  target = tmp_path / "libs" / "part.so"
  with pytest.raises(native.BuildError, match=r"cc.* failed:(.|\n)*no-such-flag"):
    compiled(native.compilers()[0], source, target, ["--no-such-flag"])
  assert list(target.parent.iterdir()) == []


def test_the_first_compiler_that_can_does_it(source, tmp_path):
  target = tmp_path / "part.so"
  attempts = [functools.partial(compiled, c, source, target) for c in (["no-such-compiler"], *native.compilers())]
  native.first_success(attempts, "the part", "qcar_twin.part")
  assert target.is_file()


def test_where_none_can_all_are_told(source, tmp_path):
  attempt = functools.partial(compiled, ["no-such-compiler"], source, tmp_path / "part.so")
  with pytest.raises(native.BuildError, match=r"the part: (.|\n)*no-such-compiler(.|\n)*`python -m qcar_twin.part`"):
    native.first_success([attempt], "the part", "qcar_twin.part")
  with pytest.raises(native.BuildError, match="no compiler was found"):
    native.first_success([], "the part", "qcar_twin.part")


def test_where_nothing_can_be_written_beside_the_source_the_users_cache_is_used(source, tmp_path, monkeypatch):
  monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
  assert native.place_for(source, "part.so").parent == source.parent / "_build"
  (source.parent / "_build").rmdir()
  (source.parent / "_build").touch()  # a file in its place: refused to the owner of the machine as well
  assert native.place_for(source, "part.so").parent == tmp_path / "cache" / "qcar_twin"
  monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # the standard says to ignore it
  monkeypatch.setenv("HOME", str(tmp_path / "home"))
  assert native.place_for(source, "part.so").parent == tmp_path / "home" / ".cache" / "qcar_twin"


def test_a_library_that_is_there_needs_no_leave_to_write(source, monkeypatch):
  library = native.place_for(source, "part.so")
  library.touch()
  monkeypatch.setattr(native.tempfile, "TemporaryFile", lambda **_: pytest.fail("it was tried to write"))
  assert native.place_for(source, "part.so") == library
