"""What a script hears that asks a person: the answers given beforehand, then the person's at a terminal, else Enter."""

import builtins
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from unittest import mock

from qcar_twin.onboard.clock import Clock


@contextmanager
def answered(clock: Clock, answers: Sequence[str]) -> Iterator[list[str]]:
  """Let `input` of the script take the given answers; simulated time stands still while a person is asked.

  Yields:
    the questions that nobody answered, as they come.
  """
  left, ask, unheard = list(answers), builtins.input, []

  def answer(prompt: object = "", /) -> str:
    if clock.current() is None:
      return ask(prompt)
    if left or not sys.stdin.isatty():
      unheard.extend([] if left else [str(prompt)])
      given = left.pop(0) if left else ""
      print(f"{prompt}{given}")
      return given
    clock.asking = True
    try:
      with clock.outside():
        return ask(prompt)
    finally:
      clock.asking = False

  with mock.patch.object(builtins, "input", answer):
    yield unheard
