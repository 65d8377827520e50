"""Which encoding a text is in: its mark of byte order, else what decodes it strictly and is the likeliest text.

A text without a mark that is UTF-8 is UTF-8, since hardly any other is by accident. Bytes that are 0 at every other
place are UTF-16. Of the rest the encoding counts under which the text is likeliest: whether a letter is one of a
language's own goes by the letter before it, and an own letter is one of those that the language mostly writes. East
Asian words are runs of such letters; European ones have them one by one among those of ASCII.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

LONGEST_LINE = 1 << 16  # bytes of a header: thousands of names
MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb\xbf": "utf-8-sig"}  # of byte order
_LOOKED_AT = 4096  # bytes of lines with letters beyond ASCII
_LETTER = 4  # bytes at most, and so many may be lacking at an end that is cut off
_WIDE = 0.4  # share of the bytes that are 0, of one kind of place, in UTF-16 of numbers and of ASCII's letters
_RARE = 1e-7  # chance of a letter that is of none of a language's kinds
_ASCII = 1.0 / 95.0  # of one of its letters
_OF_UNITS = set("°µ²³")
_EUROPEAN = set("äöüßéèêëàâîïíìóòôõúùûñçáãåæøœ±·½€šž–’“”")  # small letters, and marks


@dataclass(frozen=True)
class _Language:
  """How likely a text of one encoding is.

  codec: Python's name.
  starts, goes_on: chance that a letter is one of its own after one of ASCII, and after an own one.
  kinds: of own letters: whether a letter's bytes are of it, the share of the kind, and how many letters it has.
  """

  codec: str
  starts: float
  goes_on: float
  kinds: tuple[tuple[Callable[[bytes], bool], float, int], ...]


def _pairs(first: int, last: int, low: int = 0xA1) -> Callable[[bytes], bool]:
  """Letters of two bytes, the first from one to another, the second from `low` on."""
  return lambda letter: len(letter) == 2 and first <= letter[0] <= last and letter[1] >= low


_MARKS_OF_EUC = (_pairs(0xA1, 0xA3), 0.05, 282)  # brackets, stops and full-width letters
_EAST, _WEST = (0.2, 0.85), (0.05, 0.05)  # stated priors
# kinds by the standards' rows: common characters come first in JIS X 0208, GB 2312 and Big5; Korean is Hangul
_LANGUAGES = (
  _Language(
    "cp932",
    *_EAST,
    (
      (_pairs(0x82, 0x83, 0x40), 0.5, 169 + 188),  # kana, and full-width letters
      (_pairs(0x88, 0x97, 0x40), 0.44, 2965),
      (_pairs(0x81, 0x81, 0x40), 0.04, 147),
      (lambda letter: len(letter) == 1, 0.01, 63),  # kana of half the width
      (_pairs(0x98, 0x9F, 0x40), 0.005, 1500),
      (_pairs(0xE0, 0xEA, 0x40), 0.005, 1890),
    ),
  ),
  _Language(
    "euc_jp",
    *_EAST,
    ((_pairs(0xA4, 0xA5), 0.5, 169), (_pairs(0xB0, 0xCF), 0.44, 2965), _MARKS_OF_EUC, (_pairs(0xD0, 0xF4), 0.01, 3390)),
  ),
  _Language("gb18030", *_EAST, ((_pairs(0xB0, 0xD7), 0.93, 3755), _MARKS_OF_EUC, (_pairs(0xD8, 0xF7), 0.02, 3008))),
  _Language("cp949", *_EAST, ((_pairs(0xB0, 0xC8), 0.94, 2350), _MARKS_OF_EUC, (_pairs(0xCA, 0xFD), 0.01, 4888))),
  _Language(
    "big5",
    *_EAST,
    (
      (_pairs(0xA4, 0xC6, 0x40), 0.94, 5401),
      (_pairs(0xA1, 0xA3, 0x40), 0.05, 408),
      (_pairs(0xC9, 0xF9, 0x40), 0.01, 7652),
    ),
  ),
  _Language(
    "cp1252",
    *_WEST,
    (
      (lambda letter: letter.decode("cp1252") in _OF_UNITS, 0.4, len(_OF_UNITS)),
      (lambda letter: letter.decode("cp1252") in _EUROPEAN, 0.5, len(_EUROPEAN)),
      (lambda letter: letter.decode("cp1252").isalpha(), 0.08, 40),  # capitals
      (lambda letter: True, 0.02, 30),
    ),
  ),
)


def encoding_of(head: bytes) -> str:
  """Python's name of the encoding of a text that begins so; Latin-1, which any bytes are, where no other decodes it.

  UTF-16 without a mark is called by its order, `utf-16-le` or `utf-16-be`.
  """
  for mark, name in MARKS.items():
    if head.startswith(mark):
      return name
  if b"\x00" in head:
    return _order(head) or "utf-8"
  cut = len(head) >= LONGEST_LINE
  if _decoded(head, "utf-8", cut) is not None:
    return "utf-8"
  lines = [line for line in head.splitlines() if not line.isascii()]
  shown = b"".join(line + b"\n" for line in lines)[:_LOOKED_AT]
  likely = {
    each.codec: _likelihood(text, each)
    for each in _LANGUAGES
    if _decoded(head, each.codec, cut) is not None
    and (text := _decoded(shown, each.codec, len(shown) == _LOOKED_AT)) is not None
  }
  best = max(likely, key=lambda codec: likely[codec], default="latin1")
  # the two differ in 32 bytes, which Latin-1 has no letters for: without one it is what all of the file can be read as
  return "latin1" if best == "cp1252" and not any(0x80 <= byte < 0xA0 for byte in head) else best


def _decoded(data: bytes, codec: str, cut: bool) -> str | None:
  """A text, or where it is cut off what is whole of it; None where it is none of this encoding."""
  try:
    return data.decode(codec)
  except UnicodeDecodeError as error:
    if not cut or error.start < len(data) - _LETTER:
      return None
    return data[: error.start].decode(codec)


def _order(head: bytes) -> str | None:
  """UTF-16 without a mark, by where its zeros stand; None where there are too few for a text of numbers."""
  zeros = [head[k::2].count(0) / (len(head) / 2) for k in (0, 1)]
  if max(zeros) < 2.0 * _WIDE or min(zeros) > 0.5 * _WIDE:
    return None
  return "utf-16-be" if zeros[0] > zeros[1] else "utf-16-le"


def _likelihood(text: str, language: _Language) -> float:
  """Logarithm of the chance of a text, letter after letter."""
  total, own = 0.0, False
  chances: dict[str, float] = {}
  for letter in text:
    chance = language.goes_on if own else language.starts
    own = not letter.isascii()
    if own and letter not in chances:
      chances[letter] = _chance(letter, language)
    total += math.log(chance * chances[letter] if own else (1.0 - chance) * _ASCII)
  return total


def _chance(letter: str, language: _Language) -> float:
  """Of one of a language's own letters, among all of these."""
  try:
    data = letter.encode(language.codec)
  except UnicodeEncodeError:
    return _RARE
  return next((share / count for of_it, share, count in language.kinds if of_it(data)), _RARE)
