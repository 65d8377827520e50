"""Words of columns' names in other languages as English ones of the same meaning.

A German compound is taken apart: "Querbeschleunigung" is acceleration, lateral. A word is translated only where all
of it is known, so that English names stay what they are. Japanese, Chinese and Korean, which set no spaces, are read
from left to right, the longest known word first; what is unknown between known words is left out.
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
    "beschleunigung": "acceleration", "beschl": "acceleration", "laengs": "longitudinal",
    "langs": "longitudinal", "quer": "lateral",
    "soll": "command", "vorgabe": "command", "ist": "measured", "wert": "", "spannung": "voltage", "strom": "current",
    "batterie": "battery", "akku": "battery", "links": "left", "rechts": "right", "brems": "brake", "bremse": "brake",
    "druck": "pressure", "temperatur": "temperature", "hoehe": "height", "hohe": "height",
  },
  {
    # Spanish
    "tiempo": "time", "velocidad": "speed", "acelerador": "throttle", "direccion": "steering", "giro": "yaw",
    "guinada": "yaw", "aceleracion": "acceleration", "acel": "acceleration", "angulo": "angle", "rueda": "wheel",
    "volante": "steering wheel", "lateral": "lateral", "consigna": "command", "mando": "command",
    "deseada": "desired", "medida": "measured", "voltaje": "voltage", "bateria": "battery", "corriente": "current",
    "rumbo": "heading", "freno": "brake", "orientacion": "orientation", "izquierda": "left", "derecha": "right",
    "delantera": "front", "trasera": "rear",
    # French
    "temps": "time", "vitesse": "speed", "accelerateur": "throttle", "braquage": "steering", "lacet": "yaw",
    "volant": "steering wheel", "roue": "wheel", "moteur": "motor", "consigne": "command", "mesuree": "measured",
    "batterie": "battery", "courant": "current", "cap": "heading", "frein": "brake", "longitudinale": "longitudinal",
    "laterale": "lateral", "gaz": "throttle", "angulaire": "angular", "regime": "rpm", "commande": "command",
    "gauche": "left", "droite": "right", "avant": "front", "arriere": "rear",
    # Italian
    "velocita": "speed", "acceleratore": "throttle", "sterzo": "steering", "imbardata": "yaw", "angolo": "angle",
    "ruota": "wheel", "accelerazione": "acceleration", "tensione": "voltage", "corrente": "current",
    "comando": "command",
    # Portuguese
    "velocidade": "speed", "direcao": "steering", "aceleracao": "acceleration", "roda": "wheel", "guinagem": "yaw",
    "tensao": "voltage",
  },
)  # fmt: skip
_EAST = {
  # Japanese
  "時刻": "time", "時間": "time", "タイムスタンプ": "timestamp", "操舵": "steering", "舵角": "steering angle",
  "ステアリング": "steering", "ステア": "steering", "ハンドル": "steering wheel", "指令": "command", "目標": "target",
  "指示": "command", "入力": "command", "モータ": "motor", "モーター": "motor", "電動機": "motor",
  "スロットル": "throttle", "アクセル": "accelerator", "開度": "pedal", "ブレーキ": "brake", "車速": "speed",
  "速度": "speed", "回転数": "rpm", "車輪": "wheel", "前輪": "front wheel", "後輪": "rear wheel",
  "ヨーレート": "yaw rate", "ヨー角速度": "yaw rate", "ヨー角": "yaw", "ヨー": "yaw", "角速度": "angular velocity",
  "角度": "angle", "前後": "longitudinal", "左右": "lateral", "横": "lateral", "加速度": "acceleration",
  "電圧": "voltage", "電流": "current", "電池": "battery", "バッテリ": "battery", "バッテリー": "battery",
  "方位": "heading", "位置": "position", "実測": "measured", "実": "measured",
  # Chinese
  "时间": "time", "时刻": "time", "转向": "steering", "转角": "steering angle", "前轮": "front wheel",
  "后轮": "rear wheel", "车轮": "wheel", "目标": "target", "期望": "desired", "设定": "setpoint",
  "电机": "motor", "油门": "throttle", "占空比": "duty", "车速": "speed", "转速": "rpm", "横摆角速度": "yaw rate",
  "偏航角速度": "yaw rate", "航向角": "heading", "航向": "heading", "偏航角": "yaw", "纵向": "longitudinal",
  "横向": "lateral", "侧向": "lateral", "电压": "voltage", "电流": "current", "电池": "battery", "实际": "measured",
  "刹车": "brake", "制动": "brake",
  # Korean
  "시간": "time", "조향": "steering", "조향각": "steering angle", "명령": "command", "목표": "target",
  "모터": "motor", "스로틀": "throttle", "속도": "speed", "차속": "speed", "회전수": "rpm", "바퀴": "wheel",
  "요레이트": "yaw rate", "각속도": "angular velocity", "가속도": "acceleration", "종방향": "longitudinal",
  "횡방향": "lateral", "전압": "voltage", "전류": "current", "배터리": "battery", "브레이크": "brake",
}  # fmt: skip
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
def of_east(run: str) -> tuple[str, ...]:
  """The English words of letters in a row that are Japanese, Chinese or Korean."""
  words, at = [], 0
  while at < len(run):
    known = next((run[at:end] for end in range(len(run), at, -1) if run[at:end] in _EAST), "")
    words += _EAST.get(known, "").split()
    at += max(len(known), 1)
  return tuple(words)


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
