"""Columns that are called in another language."""

import pytest

from qcar_twin.recordings.first_dataset.names import readings
from qcar_twin.recordings.unit_names import words_of


@pytest.mark.parametrize(
  ("name", "channel"),
  [
    ("Gaspedal", "motor_duty"),
    ("Gaspedalstellung [%]", "motor_duty"),
    ("Lenkwinkel", "steering_command"),
    ("Fahrzeuggeschwindigkeit", "speed"),
    ("Sollgeschwindigkeit", "speed_command"),
    ("Drehrate", "yaw_rate"),
    ("Gierrate [°/s]", "yaw_rate"),
    ("Querbeschleunigung", "accel_y"),
    ("Längsbeschleunigung", "accel_x"),
    ("Laengsbeschleunigung", "accel_x"),
    ("Motordrehzahl", "motor_speed"),
    ("Zeit", "time"),
    ("Akkuspannung", "battery_voltage"),
    ("velocidad", "speed"),
    ("velocidad_angular", "yaw_rate"),
    ("acelerador", "motor_duty"),
    ("dirección", "steering_command"),
    ("vitesse_lacet", "yaw_rate"),
    ("accélérateur", "motor_duty"),
    ("angle de braquage", "steering_command"),
    ("velocità", "speed"),
    ("angolo_sterzo", "steering_command"),
    ("Laengsbeschl [g]", "accel_x"),
    ("Motor_Soll [%]", "motor_duty"),
    ("v_Rad [km/h]", "speed"),
    ("Consigne direction (°)", "steering_command"),
    ("Consigne moteur (%)", "motor_duty"),
    ("Vitesse roue gauche (tr/min)", "motor_speed"),
    ("acel_y", "accel_y"),
    ("mando_direccion_us", "steering_command"),
    ("操舵指令[deg]", "steering_command"),
    ("モータ指令[%]", "motor_duty"),
    ("車速[km/h]", "speed"),
    ("ヨーレート[deg/s]", "yaw_rate"),
    ("横加速度[G]", "accel_y"),
    ("转向指令", "steering_command"),
    ("横摆角速度(deg/s)", "yaw_rate"),
    ("조향각", "steering_command"),
    ("속도 명령", "speed_command"),
  ],
)
def test_a_name_in_another_language_means_its_channel(name, channel):
  assert readings(name)[0].channel == channel


@pytest.mark.parametrize("name", ["Drehmoment", "Bremsdruck", "Hinterradbremse", "Motortemperatur", "Lenkwinkel Ist"])
def test_what_is_no_channel_stays_none(name):
  assert "steering_command" not in {r.channel for r in readings(name)} and not readings(name)


@pytest.mark.parametrize(
  ("name", "words"),
  [
    ("angle_rad", ("angle", "rad")),
    ("gas", ("gas",)),
    ("motor rate", ("motor", "rate")),
    ("stellar_zenith", ("stellar", "zenith")),
    ("Lenkradwinkel", ("steering", "wheel", "angle")),
    ("備考", ()),
    ("前後加速度x", ("longitudinal", "acceleration", "x")),
  ],
)
def test_english_names_stay_and_compounds_come_apart(name, words):
  assert words_of(name) == words
