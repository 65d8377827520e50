"""How a long run says what it is doing: the protocol, and one line of it on the terminal."""

import logging
from types import TracebackType
from typing import Protocol

from tqdm import tqdm


class Progress(Protocol):
  """Told the stage a run has reached, and the share of it that is done, 0 to 1, where that is known."""

  def __call__(self, stage: str, share: float | None = None, /) -> None: ...


def silent(stage: str, share: float | None = None) -> None:
  """A `Progress` that says nothing."""


class StageLine(logging.Handler):
  """A line on the terminal; call it with the stage, and messages of the package's fits follow it.

  with StageLine() as progress:
    calibrate(dataset, progress=progress)
  """

  def __init__(self, logger: str = "calibration"):
    super().__init__(logging.INFO)
    self._logger = logging.getLogger(logger)
    self._line: tqdm | None = None
    self._before, self._stage = (logging.NOTSET, True), ""

  def __enter__(self) -> "StageLine":
    self._line = tqdm(total=0, bar_format="{elapsed} {desc}", dynamic_ncols=True)
    self._before = self._logger.level, self._logger.propagate
    self._logger.setLevel(logging.INFO)
    self._logger.propagate = False  # root's handlers would print every message of a fit between the lines
    self._logger.addHandler(self)
    return self

  def __call__(self, stage: str, share: float | None = None) -> None:
    """Show a stage, and in per cent how much of it is done."""
    self._stage = stage if share is None else f"{stage}, {100.0 * share:.0f} %"
    self._show(self._stage)

  def emit(self, record: logging.LogRecord) -> None:
    """Show a message of a fit behind the stage; pass on what is more than a message."""
    if record.levelno == logging.INFO:
      self._show(f"{self._stage}: {record.getMessage()}")
    elif logging.root.isEnabledFor(record.levelno):
      logging.root.handle(record)

  def __exit__(
    self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
  ) -> None:
    self._logger.removeHandler(self)
    level, self._logger.propagate = self._before
    self._logger.setLevel(level)
    if self._line is not None:
      self._line.close()

  def _show(self, text: str) -> None:
    if self._line is not None:
      self._line.set_description_str(text[:150])
