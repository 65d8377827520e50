"""C parts are built by whatever compiler there is, never half, and lie where they can be written."""

import functools
import os
import stat
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


@pytest.fixture
def no_folder(source, tmp_path, monkeypatch):
  """Files lie where the folder next to the source and the user's cache would be: refused to root as well."""
  monkeypatch.delenv(native.CACHE, raising=False)
  (source.parent / "_build").touch()
  (tmp_path / "cache").touch()
  monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
  (tmp_path / "tmp").mkdir()
  monkeypatch.setattr(native.tempfile, "tempdir", str(tmp_path / "tmp"))
  return tmp_path / "tmp" / f"qcar_twin-{os.geteuid()}"


def test_where_nothing_can_be_written_beside_the_source_the_users_cache_is_used(source, tmp_path, monkeypatch):
  monkeypatch.delenv(native.CACHE, raising=False)
  monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
  assert native.place_for(source, "part.so").parent == source.parent / "_build"
  (source.parent / "_build").rmdir()
  (source.parent / "_build").touch()  # a file in its place: refused to the owner of the machine as well
  assert native.place_for(source, "part.so").parent == tmp_path / "cache" / "qcar_twin"
  monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # the standard says to ignore it
  monkeypatch.setenv("HOME", str(tmp_path / "home"))
  assert native.place_for(source, "part.so").parent == tmp_path / "home" / ".cache" / "qcar_twin"


def test_without_a_cache_a_private_temporary_folder_is_used(source, no_folder):
  assert native.place_for(source, "part.so") == no_folder / "part.so"
  assert stat.S_IMODE(no_folder.stat().st_mode) == 0o700
  compiled(native.compilers()[0], source, native.place_for(source, "part.so"))
  assert native.place_for(source, "part.so").is_file()


def test_a_temporary_folder_that_others_may_write_is_not_trusted(source, no_folder, tmp_path):
  """A library that somebody else put there would run as this user."""
  no_folder.mkdir()
  (no_folder / "part.so").touch()
  no_folder.chmod(0o777)
  with pytest.raises(native.FolderError, match="it is not this user's alone"):
    native.place_for(source, "part.so")
  no_folder.rename(tmp_path / "elsewhere")
  (tmp_path / "elsewhere").chmod(0o700)
  no_folder.symlink_to(tmp_path / "elsewhere")
  with pytest.raises(native.FolderError, match="it is not this user's alone"):
    native.place_for(source, "part.so")


def test_without_any_folder_the_variable_is_named_and_no_compiler(source, no_folder, monkeypatch):
  no_folder.touch()
  with pytest.raises(native.FolderError) as refused:
    native.place_for(source, "part.so")
  said = str(refused.value)
  assert all(str(place) in said for place in (source.parent / "_build", no_folder)) and "C compiler" not in said
  assert f"set the environment variable {native.CACHE} to a folder that you may write to" in said
  monkeypatch.setenv(native.CACHE, str(no_folder.parent / "mine"))  # what the message says to do
  assert native.place_for(source, "part.so") == no_folder.parent / "mine" / "part.so"


def test_a_named_folder_that_cannot_be_written_is_said_not_replaced(source, tmp_path, monkeypatch):
  (tmp_path / "file").touch()
  monkeypatch.setenv(native.CACHE, str(tmp_path / "file"))
  with pytest.raises(native.FolderError, match=str(tmp_path / "file")):
    native.place_for(source, "part.so")


def test_a_folder_that_fills_up_is_no_fault_of_the_compiler(source, tmp_path):
  (tmp_path / "file").touch()
  attempt = functools.partial(compiled, native.compilers()[0], source, tmp_path / "file" / "part.so")
  with pytest.raises(native.FolderError, match=native.CACHE):
    native.first_success([attempt], "the part", "qcar_twin.part")


def test_a_library_that_is_there_needs_no_leave_to_write(source, monkeypatch):
  monkeypatch.delenv(native.CACHE, raising=False)
  library = native.place_for(source, "part.so")
  library.touch()
  monkeypatch.setattr(native.tempfile, "TemporaryFile", lambda **_: pytest.fail("it was tried to write"))
  assert native.place_for(source, "part.so") == library
