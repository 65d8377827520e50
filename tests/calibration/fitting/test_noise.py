"""The noise model against noise of known size."""

import numpy as np
import pytest

from calibration.fitting.noise import noise_models, standstill_seconds
from qcar_twin.recordings.recording import Recording, Stream


def recording(noise=0.02, quantum=0.0, still=3.0, moving=3.0, seed=0, bias=0.0, name="run"):
  """Stands, then drives; 100 Hz."""
  random = np.random.default_rng(seed)
  time = np.arange(0.0, still + moving, 0.01)
  drives = time >= still
  voltage = np.where(drives, 2.0, 0.0)
  speed = np.where(drives, 40.0 * (1 - np.exp(-(time - still) / 0.3)), 0.0)
  yaw_rate = (
    np.where(drives, 0.8 * np.sin(2.0 * (time - still)), 0.0) + bias + noise * random.standard_normal(len(time))
  )
  if quantum:
    yaw_rate = quantum * np.round(yaw_rate / quantum)
  values = {"motor_voltage": voltage, "motor_speed": speed, "yaw_rate": yaw_rate}
  return Recording(name, {k: Stream(time, v) for k, v in values.items()})


def test_standard_deviation_and_bias_come_from_standstill():
  noise = noise_models([recording(noise=0.02, bias=0.05, still=20.0)])["yaw_rate"]
  assert noise.source == "standstill"
  assert noise.std == pytest.approx(0.02, rel=0.05)
  assert noise.mean == pytest.approx(0.05, abs=0.002)
  assert abs(noise.autocorrelation) < 0.1
  assert noise.rate == pytest.approx(100.0, rel=1e-6)
  assert noise.latest == pytest.approx(0.01, rel=0.01)


def test_without_standstill_second_differences_give_the_noise():
  noise = noise_models([recording(noise=0.02, still=0.0, moving=20.0)])["yaw_rate"]
  assert noise.source == "differences"
  assert np.isnan(noise.mean)
  assert noise.std == pytest.approx(0.02, rel=0.1)


def test_a_trend_is_no_noise():
  time = np.arange(0.0, 5.0, 0.01)
  drift = Recording("drift", {"motor_voltage": Stream(time, np.full(len(time), 1.0)),
                              "motor_speed": Stream(time, 10.0 + 3.0 * time),
                              "yaw_rate": Stream(time, 2.0 * np.sin(0.3 * time))})  # fmt: skip
  assert noise_models([drift])["yaw_rate"].std < 2e-4  # its range is 2


def test_quantisation_is_a_floor():
  noise = noise_models([recording(noise=1e-6, quantum=0.01)])["yaw_rate"]
  assert noise.quantum == pytest.approx(0.01)
  assert noise.std >= 0.01 / np.sqrt(12.0) * 0.999


def test_an_encoder_that_shows_nothing_at_rest_is_judged_while_it_turns():
  noise = noise_models([recording()])["motor_speed"]
  assert noise.source == "differences"
  assert noise.std > 0


def test_standstill_is_counted_only_when_long_and_without_voltage():
  assert standstill_seconds([recording(still=3.0)]) == pytest.approx(2.8, abs=0.05)
  assert standstill_seconds([recording(still=0.3)]) == 0.0
  time = np.arange(0.0, 3.0, 0.01)
  pushed = Recording("pushed", {"motor_voltage": Stream(time, np.full(len(time), 0.5)),
                                "motor_speed": Stream(time, np.zeros(len(time)))})  # fmt: skip
  assert standstill_seconds([pushed]) == 0.0
  assert standstill_seconds([recording(still=2.0, name="a"), recording(still=2.0, name="b")]) == pytest.approx(
    3.6, abs=0.1
  )


def test_only_measured_channels_have_a_noise_model():
  assert set(noise_models([recording()])) == {"motor_speed", "yaw_rate"}
