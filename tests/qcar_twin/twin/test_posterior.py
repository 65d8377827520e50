"""A diagnosis's belief as a file, and cars that are drawn from it."""

import json

import numpy as np
import pytest

from agents.control.model import Model
from agents.learning.environments import Options, fleet, settings_of
from agents.learning.environments import options_from as options_of
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.posterior import BASE, FILE, Believed, Posterior, believed_twin, load_posterior, save_posterior
from qcar_twin.twin.twin import Twin
from qcar_twin.untrusted import UnreadableFile
from qcar_twin.vehicle.vehicle import Vehicle

NAMES = ("mass", "steering_offset")
LATE = Believed(("steering_offset", "steering_delay"), 0.75, (*NAMES, "steering_delay"),
                np.array([2.8, 0.03, 0.08]), np.diag([0.02, 0.002, 0.01]) ** 2)  # fmt: skip
PLAIN = Believed((), 0.25, ("mass", "gyro_bias"), np.array([2.6, 0.0]), np.diag([0.02, 0.001]) ** 2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
  made = tmp_path_factory.mktemp("diagnosed")
  twin = Twin(Vehicle.load(), select(["steering_delay"]), threads=1)
  theta = twin.parameters.nominal
  save_twin(made / BASE, twin, theta)
  theta[twin.parameters.index("steering_delay")] = 0.08
  save_twin(made / "twin.toml", twin, theta)
  save_posterior(made, Posterior((LATE, PLAIN)))
  return made


def test_a_file_holds_all_of_it(folder):
  again = load_posterior(folder)
  assert again.mechanisms == ("steering_offset", "steering_delay")
  for one, other in zip(again.models, (LATE, PLAIN), strict=True):
    assert (one.mechanisms, one.probability, one.names) == (other.mechanisms, other.probability, other.names)
    np.testing.assert_array_equal(one.values, other.values)
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_draws_have_the_models_shares_means_and_deviations(folder):
  twin, theta = believed_twin(folder, threads=1)
  assert theta[twin.parameters.index("steering_delay")] == 0.0
  assert [m.name for m in twin.mechanisms] == ["steering_offset", "steering_delay", "gyro_bias"]
  rng = np.random.default_rng(0)
  drawn = np.stack([load_posterior(folder).draw(twin, theta, rng) for _ in range(2000)])
  mass, offset, delay = (drawn[:, twin.parameters.index(n)] for n in (*NAMES, "steering_delay"))
  late = delay > 0.0
  assert late.mean() == pytest.approx(0.75, abs=0.03) and np.array_equal(late, offset != 0.0)
  assert mass[late].mean() == pytest.approx(2.8, abs=0.003) and mass[~late].mean() == pytest.approx(2.6, abs=0.003)
  assert offset[late].std() == pytest.approx(0.002, rel=0.1) and delay[late].std() == pytest.approx(0.01, rel=0.1)
  drawn_of = (*NAMES, "steering_delay", "gyro_bias")
  untouched = np.delete(np.arange(len(theta)), [twin.parameters.index(n) for n in drawn_of])
  assert np.all(drawn[:, untouched] == theta[untouched])


def test_a_fleet_draws_a_model_for_every_episode(folder):
  options = Options(randomise="posterior", diagnosis=str(folder), estimator="truth", demonstrator="", plant="reduced")
  cars = fleet(options, range(12))
  column = cars.config.plant().parameters.index("steering_delay")
  before = cars.theta[:, column]
  assert 4 <= np.sum(before > 0.0) < 12
  cars.restart(np.arange(12) < 6)
  after = cars.theta[:, column]
  assert np.all(after[6:] == before[6:]) and np.any(after[:6] != before[:6])
  for _ in range(5):
    cars.step(np.zeros(12))
  assert np.isfinite(cars.signals).all()


def test_an_informed_filter_is_told_what_the_repaired_twin_says(folder):
  plain = Options(randomise="posterior", diagnosis=str(folder), unknown=("steering_gain",))
  told = settings_of(options_of({**vars(plain), "informed": True}), Model.nominal())
  assert told.steering_delay == pytest.approx(0.08) and settings_of(plain, Model.nominal()).steering_delay == 0.0
  assert told.unknown.keys() == {"steering_gain"}


def test_an_informed_filter_hears_nothing_of_errors_that_simulated_sensors_lack(tmp_path):
  mechanisms = select(["gyro_bias", "wheel_radius_error", "imu_lever_arm", "steering_offset"])
  twin = Twin(Vehicle.load(), mechanisms, threads=1)
  wrong = {"gyro_bias": 0.1, "wheel_radius_error": 0.05, "imu_lever_arm_x": 0.03, "steering_offset": 0.02}
  file = save_twin(tmp_path / "twin.toml", twin, twin.parameters.vector(wrong))
  options = Options(twin=str(file), plant="reduced")
  plain, told = (settings_of(o, Model.nominal()) for o in (options, options_of({**vars(options), "informed": True})))
  same = ("yaw_rate_bias", "speed_scale", "imu_x", "imu_y")
  assert [getattr(told, name) for name in same] == [getattr(plain, name) for name in same]
  assert told.steering_offset == 0.02 and plain.steering_offset == 0.0


def test_what_does_not_go_together_is_refused(folder):
  for wrong in ({"randomise": "posterior"}, {"diagnosis": "x"}, {"informed": True},
                {"randomise": "posterior", "diagnosis": "x", "twin": "y.toml"}):  # fmt: skip
    with pytest.raises(ValueError, match="go together|needs what informs it"):
      options_of(wrong)
  assert options_of({"randomise": True}).randomise == "prior" and options_of({"randomise": False}).randomise == "none"


def test_files_that_are_none_are_refused_by_name(folder, tmp_path):
  with pytest.raises(FileNotFoundError, match="qcar-twin diagnose --out"):
    load_posterior(tmp_path)
  right = json.loads((folder / FILE).read_text(encoding="utf-8"))
  short, half = json.loads(json.dumps(right)), json.loads(json.dumps(right))
  short["models"][0]["values"] = [1.0]
  half["models"] = half["models"][:1]
  nameless = {"models": [{k: v for k, v in right["models"][0].items() if k != "names"}]}
  for content, said in ((short, "model 0 has numbers"), (half, "sum up to 1"), (nameless, "model 0 cannot be read"),
                        ({"models": []}, "no list of models")):  # fmt: skip
    (tmp_path / FILE).write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(UnreadableFile, match=said):
      load_posterior(tmp_path)
