"""One line of progress for a long run: the stage, the latest message of a fit, the time it takes."""

import logging
from types import TracebackType

from tqdm import tqdm


class StageLine(logging.Handler):
  """A line on the terminal; call it with the stage, and messages of the package's fits follow it.

  with StageLine() as progress:
    calibrate(dataset, progress=progress)
  """

  def __init__(self, logger: str = "calibration"):
    super().__init__(logging.INFO)
    self._logger = logging.getLogger(logger)
    self._line: tqdm | None = None
    self._before, self._stage = logging.NOTSET, ""

  def __enter__(self) -> "StageLine":
    self._line = tqdm(total=0, bar_format="{elapsed} {desc}", dynamic_ncols=True)
    self._before = self._logger.level
    self._logger.setLevel(logging.INFO)
    self._logger.addHandler(self)
    return self

  def __call__(self, stage: str) -> None:
    """Show a stage."""
    self._stage = stage
    self._show(stage)

  def emit(self, record: logging.LogRecord) -> None:
    """Show a message of a fit behind the stage."""
    if record.levelno == logging.INFO:
      self._show(f"{self._stage}: {record.getMessage()}")

  def __exit__(
    self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
  ) -> None:
    self._logger.removeHandler(self)
    self._logger.setLevel(self._before)
    if self._line is not None:
      self._line.close()

  def _show(self, text: str) -> None:
    if self._line is not None:
      self._line.set_description_str(text[:150])
