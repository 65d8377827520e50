"""Encodings without a mark are told by the likeliest text."""

import pytest

from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.formats.text.encodings import LONGEST_LINE, encoding_of

JAPANESE = "時刻,舵角指令[deg],モータ[%],車速[km/h],ヨーレート[deg/s]"
CHINESE = "时间,转向角[deg],油门[%],车速[m/s],横摆角速度[rad/s]"
KOREAN = "시간,조향각[deg],스로틀[%],속도[m/s],요레이트[rad/s]"
FRENCH = "Température;Régime (tr/min);Accél. long. (m/s²);créée;Boîte"


@pytest.mark.parametrize(
  ("text", "encoding"),
  [
    (JAPANESE, "cp932"),
    (JAPANESE, "euc_jp"),
    (CHINESE, "gb18030"),
    ("时间,速度", "gb18030"),
    (KOREAN, "cp949"),
    ("시간,속도", "cp949"),
    ("時間,轉向角,油門,車速,偏航角速度", "big5"),
    (FRENCH, "latin1"),
    ("Zeit;Größe;Winkel [°];Ölstand", "latin1"),
    ("t,°C", "latin1"),
    ("v [m/s²]", "latin1"),
    ("señal “x” – €", "cp1252"),
    (JAPANESE, "utf-8"),
    ("time,speed", "utf-8"),
    ("time,speed", "utf-16-le"),
    ("time,Größe", "utf-16-be"),
  ],
)
def test_an_encoding_is_told_by_the_header(text, encoding):
  data = (text + "\n" + "0.5,1.5,2.5\n" * 9).encode(encoding)
  assert encoding_of(data) == encoding


def test_a_letter_that_is_cut_off_at_the_end_does_not_count():
  data = ("a" + "あ" * LONGEST_LINE).encode("cp932")[:LONGEST_LINE]
  assert encoding_of(data) == "cp932"


@pytest.mark.parametrize(("header", "encoding"), [(JAPANESE, "cp932"), (CHINESE, "gbk"), (KOREAN, "euc_kr")])
def test_names_come_out_as_they_were_written(tmp_path, header, encoding):
  path = tmp_path / "log.csv"
  path.write_bytes("\n".join([header, *(f"{0.02 * k:.2f},1,2,{k},4" for k in range(40))]).encode(encoding))
  table = read_table(path)
  assert list(table.columns) == header.split(",") and table.columns[header.split(",")[3]][7] == 7.0
