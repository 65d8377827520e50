"""The tyre's law on a rig: forces of one wheel on prescribed paths against closed forms."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qcar_twin.vehicle.tyre import law_parameters, slip_over_linear, tyre_laws
from tests import ROOT
from tests.qcar_twin.vehicle.tyre.rig import SHARED, Rig, peak_friction, recovered_relaxation, steady_force

each_law = pytest.mark.parametrize("law", tyre_laws())


@each_law
def test_a_law_has_the_stiffness_and_the_peak_it_is_asked_for(law):
  """However it rises and falls: linear at small slip, never above mu F_z, and nearly there somewhere."""
  force = Rig.of(law=law).run(1.0, 1e-3, 1.0, 0.05)[-1]
  assert force[1] == pytest.approx(-SHARED["cornering_stiffness"] * 1e-3, rel=0.01) and abs(force[0]) < 1e-6
  for direction in (0.0, np.pi / 2):
    assert 0.75 * SHARED["friction_coefficient"] < peak_friction(direction, law) < 1.02 * SHARED["friction_coefficient"]


@each_law
def test_a_law_only_takes_energy(law):
  rig = Rig.of(law=law, relaxation_length=0.02)
  for forward, left, rolling in ((1.0, 0.3, 0.5), (0.2, -0.5, 1.0), (0.6, 0.8, 0.0)):
    force = rig.run(forward, left, rolling, 0.4)[-1]
    assert force[0] * (forward - rolling) + force[1] * left < 0.0


@each_law
@pytest.mark.parametrize("used", [0.05, 0.5, 0.9])
def test_a_law_that_says_which_slip_a_force_takes_takes_that_slip(law, used):
  """A law that says nothing is taken for linear, which the first force shows alone."""
  values = {p.name: np.array([p.nominal]) for p in law_parameters(law)}
  more = float(slip_over_linear(law)(np.array([used]), values)[0])
  if more == 1.0:
    pytest.skip(f"the law '{law}' has no inverse of its own")
  most = SHARED["friction_coefficient"] * SHARED["nominal_load"]
  slip = more * used * most / SHARED["cornering_stiffness"]
  force = Rig.of(law=law).run(np.sqrt(1.0 - slip**2), slip, np.sqrt(1.0 - slip**2), 0.05)[-1]
  assert force[1] == pytest.approx(-used * most, rel=0.005)


@each_law
def test_a_law_has_its_section_on_the_page(law):
  page = (ROOT / "docs" / "reference" / "tyre.md").read_text(encoding="utf-8")
  assert f"\n### {law}\n" in page
  assert all(f"`{p.name}`" in page for p in law_parameters(law))


@pytest.mark.parametrize("speed", [0.3, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("h", [0.0005, 0.002, 0.004, 0.005])
def test_cornering_stiffness_is_the_one_asked_for(speed, h):
  slip_angle = 0.01
  force = Rig.of(h=h).run(speed, speed * np.tan(slip_angle), speed, 0.05)[-1]
  assert force[1] == pytest.approx(-90.0 * slip_angle, rel=0.01)
  assert abs(force[0]) < 1e-3 * abs(force[1])


@pytest.mark.parametrize("relaxation", [0.0, 0.01, 0.1])
def test_stiffness_does_not_depend_on_relaxation(relaxation):
  force = Rig.of(relaxation_length=relaxation, longitudinal_relaxation=relaxation, carcass_damping=40.0).run(
    1.0, 0.01, 1.0, 1.5
  )[-1]
  assert force[1] == pytest.approx(steady_force(1.0, 0.01, 1.0)[1], rel=2e-3)


def test_longitudinal_stiffness_is_its_own():
  force = Rig.of().run(1.0, 0.0, 1.002, 0.05)[-1]  # driven: the rubber moves backwards, the ground pushes forwards
  assert force[0] == pytest.approx(135.0 * 0.002 / 1.002, rel=0.005)
  assert abs(force[1]) < 1e-9


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
  left=st.floats(-0.8, 0.8),
  rolling=st.floats(0.3, 1.7),
  load=st.floats(3.0, 10.0),
  exponent=st.sampled_from([0.0, 0.2]),
  shape=st.floats(1.05, 1.9),
)
def test_combined_slip_is_the_closed_form(left, rolling, load, exponent, shape):
  tyre = {"load_exponent": exponent, "tyre_shape": shape}
  force = Rig.of(load=load, **tyre).run(1.0, left, rolling, 0.3)[-1]
  assert force[2] == pytest.approx(load, rel=0.01)
  np.testing.assert_allclose(force[:2], steady_force(1.0, left, rolling, force[2], **tyre), rtol=5e-3, atol=5e-3)


@pytest.mark.parametrize("direction", [0.0, 0.6, np.pi / 2])
def test_peak_friction(direction):
  assert peak_friction(direction) == pytest.approx(0.8, rel=0.02)


def test_peak_friction_falls_with_load_as_stated():
  peaks = []
  for load in (3.3, 6.6, 13.2):
    rig = Rig.of(load=load, load_exponent=0.3)
    peaks.append(max(-rig.run(1.0, slip, 1.0, 0.05)[-1, 1] for slip in np.linspace(0.05, 0.6, 25)) / load)
  np.testing.assert_allclose(peaks, [0.8 * 2**0.3, 0.8, 0.8 * 2**-0.3], rtol=0.02)


def test_locked_wheel_slides_with_kinetic_friction_against_its_motion():
  force = Rig.of().run(0.6, 0.8, 0.0, 0.1)[-1]
  np.testing.assert_allclose(
    force[:2] / np.hypot(*force[:2]) @ [0.6, 0.8], -0.98, atol=0.021
  )  # stiffer along than across
  assert np.hypot(*force[:2]) == pytest.approx(np.linalg.norm(steady_force(0.6, 0.8, 0.0)), rel=0.01)


@pytest.mark.parametrize("length", [0.03, 0.1])
@pytest.mark.parametrize("speed", [0.5, 1.5])
@pytest.mark.parametrize("damping", [0.0, 40.0])
@pytest.mark.parametrize("axis", [0, 1], ids=["along", "across"])
def test_relaxation_length_comes_back_from_a_step(length, speed, damping, axis):
  recovered, start = recovered_relaxation(length, speed, damping, axis)
  assert recovered == pytest.approx(length, rel=0.05)
  assert abs(start) < 0.05  # no jump: carcass damping has faded


@pytest.mark.parametrize("motion", [(1.0, 0.05, 1.0), (1.0, 0.0, 1.04), (0.8, -0.03, 0.78)])
def test_a_tyre_whose_state_is_unset_begins_at_its_steady_slip_and_stays_there(motion):
  rig = Rig.of(relaxation_length=0.05, longitudinal_relaxation=0.05)
  rig.data.plugin_state[:] = -1.0, 0.0, 0.0  # what a reset writes
  forces = rig.run(*motion, 0.05)
  np.testing.assert_allclose(forces[:, :2], np.tile(steady_force(*motion), (len(forces), 1)), rtol=0.01, atol=1e-3)


def test_no_relaxation_is_exactly_the_steady_tyre():
  motions = [(1.0, 0.1, 1.0), (1.0, -0.3, 0.8), (0.5, 0.05, 0.6)]
  tracks = []
  for length in (0.0, 1e-12):
    rig = Rig.of(relaxation_length=length, longitudinal_relaxation=length, carcass_damping=40.0)
    tracks.append(np.concatenate([rig.run(*motion, 0.05) for motion in motions]))
  np.testing.assert_allclose(tracks[0], tracks[1], rtol=0, atol=1e-7)


def test_sparse_and_dense_agree():
  a, b = (Rig.of(jacobian=kind, relaxation_length=0.02).run(1.0, 0.2, 0.9, 0.3) for kind in ("dense", "sparse"))
  np.testing.assert_allclose(a, b, atol=1e-9)


def test_box_floor_is_as_good_as_a_plane():
  """The contact normal of a box points the other way."""
  a, b = (Rig.of(floor=kind, relaxation_length=0.02).run(1.0, 0.2, 0.9, 0.3)[-1] for kind in ("plane", "box"))
  np.testing.assert_allclose(a, b, rtol=5e-3, atol=5e-3)


def test_friction_cone_is_consistent_and_outside_the_peak():
  """MuJoCo's elliptic cone needs friction_1^2 R_1 = friction_2^2 R_2 = mu^2 R_normal, whatever the stiffnesses."""
  rig = Rig.of(relaxation_length=0.02, longitudinal_relaxation=0.02)
  rig.run(1.0, 0.1, 0.9, 0.1)
  contact = rig.data.contact[0]
  R = rig.data.efc_R[contact.efc_address : contact.efc_address + 3]
  np.testing.assert_allclose(contact.friction[:2] ** 2 * R[1:], contact.mu**2 * R[0], rtol=1e-9)
  # across, the end of a step counts for at least a half of it, in the slip and in the force
  assert 0.25 < R[1] / R[2] * 135.0 / 90.0 < 1.0
  assert contact.friction[:2].min() == pytest.approx(1.5 * 0.8)


def test_a_wall_is_not_the_ground():
  rig = Rig.of(wall=True)
  rig.run(0.05, 0.0, 0.0, 0.25)
  assert rig.data.ncon == 2 and rig.data.qfrc_constraint[0] < -50.0
  assert rig.state[0] == pytest.approx(6.6, rel=0.02)


def test_mirror():
  a = Rig.of(relaxation_length=0.02).run(1.0, 0.2, 0.9, 0.2)
  b = Rig.of(relaxation_length=0.02).run(1.0, -0.2, 0.9, 0.2)
  np.testing.assert_allclose(a * [1, -1, 1], b, atol=1e-9)


def test_air_forgets_and_landing_starts_fresh():
  rig = Rig.of(relaxation_length=0.05)
  rig.run(1.0, 0.2, 1.0, 0.3)
  rig.data.qpos[2] = 0.02
  forces = rig.run(1.0, 0.2, 1.0, 0.03)
  assert not forces[2:].any() and not rig.state.any()
  landed = rig.run(1.0, 0.2, 1.0, 1.0)
  assert np.isfinite(landed).all()
  np.testing.assert_allclose(landed[-1, :2], steady_force(1.0, 0.2, 1.0), rtol=0.01, atol=5e-3)


def test_first_step_after_a_reset_has_steady_slip():
  rig = Rig.of(relaxation_length=0.1)
  position = rig.data.qpos.copy()
  mujoco.mj_resetData(rig.model, rig.data)
  rig.data.qpos[:] = position
  assert rig.run(1.0, 0.1, 1.0, 0.002)[0, 1] == pytest.approx(steady_force(1.0, 0.1, 1.0)[1], rel=0.02)


@pytest.mark.parametrize(
  "law, name",
  [(law, p.name) for law in tyre_laws() for p in law_parameters(law)]
  + [("sine", name) for name in sorted(set(SHARED) - {"nominal_load"})],
)
def test_forces_are_smooth_in_every_parameter(law, name):
  """Central differences agree over two decades of step: a fit may differentiate through the tyre."""
  base = SHARED | {
    "relaxation_length": 0.02,
    "longitudinal_relaxation": 0.01,
    "carcass_damping": 20.0,
    "load_exponent": 0.2,
    "rim_mass": 0.1,
  }
  base |= {p.name: p.nominal for p in law_parameters(law)}

  def track(value: float) -> np.ndarray:
    rig = Rig.of(load=8.0, law=law, **(base | {name: value}))
    return np.concatenate(
      [rig.run(0.02, 0.003, 0.0, 0.02), rig.run(1.0, 0.08, 0.95, 0.05), rig.run(1.0, 0.4, 0.9, 0.05)]
    )

  def slope(step: float) -> np.ndarray:
    value = base[name]
    return (track(value * (1 + step)) - track(value * (1 - step))) / (2 * value * step)

  coarse, fine = slope(1e-3), slope(1e-5)
  scale = np.abs(fine).max()
  assert scale > 0.0
  np.testing.assert_allclose(coarse, fine, atol=2e-3 * scale)
