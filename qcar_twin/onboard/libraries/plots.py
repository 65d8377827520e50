"""Plots that are shown nowhere: a drive takes a second, and the recording has the signals."""

from typing import Any, ClassVar

from qcar_twin.onboard.rig import Rig


class Scope:
  """A plot, or a part of one: whatever it is asked or told, it takes and forgets."""

  rig: ClassVar[Rig]

  def __init__(self, *_: Any, **__: Any):
    pass

  def __getattr__(self, name: str) -> "Scope":
    if name.startswith("__"):
      raise AttributeError(name)
    return self

  def __call__(self, *_: Any, **__: Any) -> "Scope":
    """Take a moment, as drawing does: scripts wait by it."""
    self.refreshAll()
    return self

  def __getitem__(self, _: Any) -> "Scope":
    return self

  @classmethod
  def refreshAll(cls) -> None:
    """Nothing is drawn, which takes a moment: scripts wait by it."""
    cls.rig.clock.read()
