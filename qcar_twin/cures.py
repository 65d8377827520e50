"""What to do about what the computer lacks: room on a disk, leave to write, OpenGL; words of earlier versions."""

import errno
import traceback

_ROOM = "free some space, or name a folder on another disk; what was finished before is whole"
_LEAVE = "name a folder that you may write to, or change its permissions"
_FILE = "a file is where a folder has to be; name another folder"
_CURES = {
  errno.ENOSPC: _ROOM,
  errno.EDQUOT: _ROOM,
  errno.EFBIG: "files may not grow that large here (`ulimit -f`); raise the limit, or name a folder elsewhere",
  errno.EACCES: _LEAVE,
  errno.EPERM: _LEAVE,
  errno.EROFS: _LEAVE,
  errno.EEXIST: _FILE,
  errno.ENOTDIR: _FILE,
  errno.EISDIR: "a folder is where a file has to be; name a file",
}
RENAMED_OPTIONS = {  # earlier word -> today's
  "--mechanism": "--add-mechanisms",
  "--mechanisms": "--candidates",
  "--onboard-lateness": "--onboard-latency",
}
RENAMED_PLANTS = {"twin": "mujoco"}
_OPENGL = ("OpenGL", "mujoco/rendering", "mujoco/egl", "mujoco/osmesa")


def cure(error: Exception) -> str | None:
  """A sentence on an error of files and of what the computer lacks, with what to do; None for any other error."""
  if isinstance(error, OSError) and error.errno in _CURES:
    return f"{error.filename or 'a file'}: {error.strerror}; {_CURES[error.errno]}"
  if isinstance(error, OSError):
    said = error.strerror or str(error)
    return f"{error.filename}: {said}" if error.filename else said
  frames = traceback.extract_tb(error.__traceback__)
  if frames and any(part in frames[-1].filename.replace("\\", "/") for part in _OPENGL):
    return (
      f"the OpenGL that MUJOCO_GL asks for is not there ({type(error).__name__}: {error}); unset MUJOCO_GL, or install"
      " it: on Debian libegl1 for egl, libosmesa6 for osmesa"
    )
  return None
