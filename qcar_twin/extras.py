"""Packages that only some uses need: which extra installs each, and the error that names it.

  with extra("Reading MCAP"):
    from mcap.reader import make_reader

A plain installation diagnoses CSV files; everything else imports its packages in such a block.
"""

from collections.abc import Iterator
from contextlib import contextmanager

EXTRA_OF = {
  "dm_control": "environments",
  "dm_env": "environments",
  "gymnasium": "environments",
  "safetensors": "environments",
  "onnx": "learn",
  "onnxruntime": "learn",
  "ruamel": "learn",
  "stable_baselines3": "learn",
  "tensorboard": "learn",
  "torch": "learn",
  "h5py": "matlab",
  "matio": "matlab",
  "mcap": "logs",
  "mcap_protobuf": "logs",
  "rosbags": "logs",
  "imageio": "film",
  "imageio_ffmpeg": "film",
  "ray": "cluster",
  "filterpy": "filterpy",
}
"""Package as it is imported -> the extra of pyproject.toml that installs it."""


class MissingExtra(ImportError):
  """A package of an extra is not installed; the message names the extra and the command that installs it."""


@contextmanager
def extra(use: str) -> Iterator[None]:
  """Imports for one use, a sentence's subject such as "Reading MCAP".

  Raises:
    MissingExtra: a package of an extra is absent. Any other ImportError is left as it is.
  """
  try:
    yield
  except ModuleNotFoundError as error:
    name = EXTRA_OF.get((error.name or "").partition(".")[0])
    if name is None:
      raise
    raise MissingExtra(f"{use} needs the extra '{name}': pip install 'qcar-twin[{name}]'", name=error.name) from error
