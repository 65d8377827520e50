"""Words of columns' names in German, Spanish, French, Italian and Portuguese, as English ones of the same meaning.

A German compound is taken apart: "Querbeschleunigung" is acceleration, lateral. A word is translated only where all
of it is known, so that English names stay what they are.
"""

import functools
import unicodedata

_DE, _ROMANCE = (
  {
    "zeit": "time", "zeitstempel": "timestamp", "sekunden": "sec", "uhrzeit": "time",
    "geschwindigkeit": "speed", "tempo": "speed", "drehzahl": "rpm", "rad": "wheel", "hinter": "rear",
    "vorder": "front", "fahrzeug": "vehicle", "motor": "motor", "gas": "throttle", "pedal": "", "stellung": "",
    "fahr": "",
    "lenk": "steering", "lenkung": "steering", "lenkrad": "steering wheel", "winkel": "angle",
    "einschlag": "angle",
    "gier": "yaw", "dreh": "yaw", "rate": "rate", "kurs": "heading", "kompass": "compass", "richtung": "heading",
    "beschleunigung": "acceleration", "laengs": "longitudinal", "langs": "longitudinal", "quer": "lateral",
    "soll": "command", "vorgabe": "command", "ist": "measured", "wert": "", "spannung": "voltage", "strom": "current",
    "batterie": "battery", "akku": "battery", "links": "left", "rechts": "right", "brems": "brake", "bremse": "brake",
    "druck": "pressure", "temperatur": "temperature", "hoehe": "height", "hohe": "height",
  },
  {
    # Spanish
    "tiempo": "time", "velocidad": "speed", "acelerador": "throttle", "direccion": "steering", "giro": "yaw",
    "guinada": "yaw", "aceleracion": "acceleration", "angulo": "angle", "rueda": "wheel", "volante": "steering wheel",
    "lateral": "lateral", "consigna": "command", "deseada": "desired", "medida": "measured", "voltaje": "voltage",
    "bateria": "battery", "corriente": "current", "rumbo": "heading", "freno": "brake", "orientacion": "orientation",
    # French
    "temps": "time", "vitesse": "speed", "accelerateur": "throttle", "braquage": "steering", "lacet": "yaw",
    "volant": "steering wheel", "roue": "wheel", "moteur": "motor", "consigne": "command", "mesuree": "measured",
    "batterie": "battery", "courant": "current", "cap": "heading", "frein": "brake", "longitudinale": "longitudinal",
    "laterale": "lateral", "gaz": "throttle", "angulaire": "angular", "regime": "rpm", "commande": "command",
    # Italian
    "velocita": "speed", "acceleratore": "throttle", "sterzo": "steering", "imbardata": "yaw", "angolo": "angle",
    "ruota": "wheel", "accelerazione": "acceleration", "tensione": "voltage", "corrente": "current",
    "comando": "command",
    # Portuguese
    "velocidade": "speed", "direcao": "steering", "aceleracao": "acceleration", "roda": "wheel", "guinagem": "yaw",
    "tensao": "voltage",
  },
)  # fmt: skip
_LINKS = ("s", "es", "en", "n", "")  # letters that join the parts of a German compound
# English words, too, or a unit
_ALONE = {"rad", "rate", "motor", "pedal", "lateral", "tempo", "gas", "dreh", "fahr", "cap", "wert"}


def plain(name: str) -> str:
  """A name without accents: "Längs" is "Langs", "ß" is "ss"."""
  if name.isascii():
    return name
  marked = unicodedata.normalize("NFD", name.replace("ß", "ss"))
  return "".join(mark for mark in marked if not unicodedata.combining(mark))


@functools.cache
def in_english(word: str) -> tuple[str, ...]:
  """The English words of one lower-case word, which stays as it is where not all of it is known."""
  if word in _ALONE:
    return (word,)
  if word in _ROMANCE:
    return tuple(_ROMANCE[word].split())
  parts = _compound(word)
  return (word,) if parts is None else tuple(english for part in parts for english in _DE[part].split())


def _compound(word: str) -> tuple[str, ...] | None:
  """The known parts of a German word, longest first; None where they are not all of it."""
  if not word:
    return ()
  for end in range(len(word), 2, -1):
    if word[:end] not in _DE:
      continue
    for link in _LINKS if end < len(word) else ("",):
      if word[end:].startswith(link) and (rest := _compound(word[end + len(link) :])) is not None:
        return (word[:end], *rest)
  return None
