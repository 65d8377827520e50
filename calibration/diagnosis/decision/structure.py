"""Structure that a model leaves over in a channel, as plain numbers; what looks for it is `unexplained`."""

import dataclasses

# what is known of a nameless error by the family it follows
PROPERTIES = {
  "motion": "a function of the motion",
  "commands": "follows the commands of the last 0.4 s",
  "heading": "turns with the heading",
  "place": "tied to a place",
  "history": "remembers the last seconds",
  "rhythm": "periodic",
  "bursts": "comes in short bursts",
  "error": "many times the sensor's noise where nothing was fitted",
}


@dataclasses.dataclass(frozen=True)
class Leftover:
  """Structure in one channel.

  Attributes:
    channel: where it shows.
    family: of PROPERTIES; "error" is all that a channel's error is.
    depends_on: variables it follows, in words.
    nats: held-out gain per block of about three seconds; for a rhythm, the line's excess per stretch; for bursts, no
      nats but the odds that an error falls into one; for an error, its multiple of the sensor's noise.
    t: of a smooth one, Student's t of the blocks' held-out gains; None of all others.
    count: blocks, stretches or windows behind it.
    size: RMS of the structure as a share of the spread of what the channel measured.
  """

  channel: str
  family: str
  depends_on: tuple[str, ...]
  nats: float
  t: float | None = None
  count: int = 0
  size: float = 0.0
