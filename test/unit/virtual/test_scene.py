"""The traced sensor against the contract's closed forms, and what they leave out."""

import numpy as np
import pytest

from stepdiag_ros.model import sensor
from stepdiag_ros.model.description import DIAGONALS, LINEAR, Machine, Setup
from stepdiag_ros.model.machine import rotation
from stepdiag_ros.model.mirror_form import FlatForm, SphericalForm, quadratic_form
from stepdiag_ros.model.optics import Body, Plane
from stepdiag_ros.model.sensor import Misalignment
from stepdiag_ros.virtual import scene as scene_module
from stepdiag_ros.virtual.scene import SensorScene

MACHINE = Machine('paper', 'FXYZ', (0.8, 0.6, 0.5), (0.01, -0.02, -0.15))
LAYOUT_A = ((0.0, 0.0), (0.025, 0.0), (0.0, 0.025))
LASER, MOUNT = (7e-4, 1e-3), (1e-4, 3e-4)
"""Misalignments of Dahlem et al., fig. 5."""


def setup(name, beams=LAYOUT_A):
    linear = {'length': 0.4, 'stops': 5} if name in LINEAR else {}
    return Setup(name, 0.35, (0.02, -0.01), beams, **linear)


def poses(n=300, seed=1, turn=5e-5):
    rng = np.random.default_rng(seed)
    p = rng.uniform(0, 1, (n, 3)) * MACHINE.volume + MACHINE.tool + rng.normal(0, 2e-5, (n, 3))
    return p, rotation(rng.normal(0, turn, (n, 3)))


@pytest.mark.parametrize('name', DIAGONALS + LINEAR)
@pytest.mark.parametrize(('laser', 'mount'), [((0.0, 0.0), (0.0, 0.0)), (LASER, MOUNT), ((-4e-3, 3e-3), (2e-3, -5e-3))])
def test_a_flat_mirror_reads_as_the_contract_says(name, laser, mount):
    p, R = poses()
    want, spots = sensor.measure(MACHINE, setup(name), Misalignment(laser, mount), p, R)
    got = SensorScene.of_setup(MACHINE, setup(name)).measure(p, R, beam_tilt=laser, mirror_tilt=mount)
    assert np.abs(got.distance - want).max() < 1e-14
    assert np.abs(got.spot - spots).max() < 1e-14


def test_a_turned_mirror_moves_the_spot_as_the_contract_says():
    given = setup('ppp')
    base = sensor.station(MACHINE, given)
    p = (base.origin + 1.2 * base.triad[2])[None]
    reading = SensorScene.of_setup(MACHINE, given).measure(p, np.eye(3), mirror_tilt=(3e-6, -2e-6))
    np.testing.assert_allclose(reading.spot[0], [-2 * 1.2 * -2e-6, 2 * 1.2 * 3e-6], atol=1e-9)


def test_tilts_may_differ_from_pose_to_pose():
    p, R = poses(6)
    rng = np.random.default_rng(2)
    lasers, mounts = rng.normal(0, 1e-3, (2, 6, 2))
    scene = SensorScene.of_setup(MACHINE, setup('pnp'))
    together = scene.measure(p, R, beam_tilt=lasers, mirror_tilt=mounts)
    for i in range(6):
        alone = scene.measure(p[i:i + 1], R[i:i + 1], beam_tilt=lasers[i], mirror_tilt=mounts[i])
        np.testing.assert_allclose(together.distance[i], alone.distance[0], atol=1e-15)
        np.testing.assert_allclose(together.spot[i], alone.spot[0], atol=1e-15)


def test_blocks_do_not_show(monkeypatch):
    p, R = poses(50)
    scene = SensorScene.of_setup(MACHINE, setup('ppp'))
    index = 1.0 + 1e-4 * np.arange(50)
    whole = scene.measure(p, R, beam_tilt=LASER, ambient=index)
    monkeypatch.setattr(scene_module, 'BLOCK', 7)
    parts = scene.measure(p, R, beam_tilt=LASER, ambient=index)
    np.testing.assert_allclose(parts.distance, whole.distance, atol=1e-15)
    np.testing.assert_allclose(parts.spot, whole.spot, atol=1e-15)


def test_no_pose_gives_empty_arrays():
    reading = SensorScene.of_setup(MACHINE, setup('ppp')).measure(np.zeros((0, 3)), np.zeros((0, 3, 3)))
    assert reading.distance.shape == (0, 3)
    assert reading.spot.shape == (0, 2)


def test_layout_a_measures_the_tilt_by_differences():
    given = setup('ppp')
    base = sensor.station(MACHINE, given)
    p = (base.origin + 0.9 * base.triad[2])[None]
    alpha, beta = 40e-6, -25e-6
    distance = SensorScene.of_setup(MACHINE, given).measure(p, np.eye(3), mirror_tilt=(alpha, beta)).distance[0]
    # A turn α about u lowers the mirror's +v side towards the light: exactly tan α over the offset.
    assert (distance[2] - distance[0]) / 0.025 == pytest.approx(alpha, rel=1e-8)
    assert (distance[1] - distance[0]) / 0.025 == pytest.approx(-beta, rel=1e-8)


def test_psd_zero_is_added_to_the_spot():
    p, R = poses(5)
    scene = SensorScene.of_setup(MACHINE, setup('nnp'))
    moved = scene.measure(p, R, psd_zero=(1.5e-3, 2e-3)).spot - scene.measure(p, R).spot
    np.testing.assert_allclose(moved, np.tile([1.5e-3, 2e-3], (5, 1)), atol=1e-15)


def test_air_lengthens_the_optical_path_and_leaves_the_spot():
    p, R = poses(5)
    scene = SensorScene.of_setup(MACHINE, setup('nnp'))
    index = 1.0 + 1e-4 * np.arange(1, 6)
    vacuum, air = scene.measure(p, R), scene.measure(p, R, ambient=index)
    np.testing.assert_allclose(air.distance, vacuum.distance * index[:, None], rtol=1e-15)
    np.testing.assert_array_equal(air.spot, vacuum.spot)


def test_without_a_psd_there_is_no_spot():
    p, R = poses(5)
    base = sensor.station(MACHINE, setup('ppp'))
    assert SensorScene(base.origin, base.triad, 0.35, psd_offset=None).measure(p, R).spot is None


def across(reach=1.0, extent=0.05, n=41):
    """A straight mirror carried along u in front of the beam: p (n, 3), where the beam strikes it (n,)."""
    base = sensor.station(MACHINE, setup('ppp'))
    offset = np.linspace(-extent, extent, n)
    return base.origin + reach * base.triad[2] + offset[:, None] * base.triad[0], -offset


def test_curvature_shows_as_height_and_slope_at_the_strike():
    p, strike = across()
    c = 2e-5
    scene = SensorScene.of_setup(MACHINE, setup('ppp', ((0.0, 0.0),)))
    flat = scene.measure(p, np.eye(3)[None].repeat(len(p), 0))
    bent = scene.measure(p, np.eye(3)[None].repeat(len(p), 0), mirror_form=SphericalForm(c))
    np.testing.assert_allclose((bent.distance - flat.distance)[:, 0], -0.5 * c * strike**2, atol=1e-15)
    # The PSD's beam strikes at its own offset; a slope s turns the ray by 2 s over the metre back.
    np.testing.assert_allclose((bent.spot - flat.spot)[:, 0], -2.0 * c * (strike + 0.02), atol=2e-11)
    np.testing.assert_allclose((bent.spot - flat.spot)[:, 1], -2.0 * c * -0.01 * np.ones(len(p)), atol=2e-11)


def test_sphere_and_height_function_agree_where_they_should():
    p, R = poses(200)
    scene = SensorScene.of_setup(MACHINE, setup('ppp'))
    common = {'beam_tilt': LASER, 'mirror_tilt': MOUNT}
    sphere = scene.measure(p, R, mirror_form=SphericalForm(1e-4), **common)
    paraboloid = scene.measure(p, R, mirror_form=quadratic_form(1e-4), **common)
    # They part by c³r⁴/8 in height and c³r³/2 in slope: r < 0.8 m here.
    assert np.abs(sphere.distance - paraboloid.distance).max() < 1e-12 / 8
    assert np.abs(sphere.spot - paraboloid.spot).max() < 2e-12
    for none in (FlatForm(), SphericalForm(0.0), quadratic_form(0.0)):
        assert np.abs(scene.measure(p, R, mirror_form=none, **common).distance
                      - scene.measure(p, R, **common).distance).max() < 1e-14


def test_astigmatism_bends_the_two_ways_apart():
    p, strike = across()
    a = 3e-5
    R = np.eye(3)[None].repeat(len(p), 0)
    scene = SensorScene.of_setup(MACHINE, setup('ppp', ((0.0, 0.0),)))
    flat = scene.measure(p, R).distance[:, 0]
    np.testing.assert_allclose(scene.measure(p, R, mirror_form=quadratic_form(0.0, a)).distance[:, 0] - flat,
                               -0.5 * a * strike**2, atol=1e-15)
    np.testing.assert_allclose(scene.measure(p, R, mirror_form=quadratic_form(0.0, 0.0, a)).distance[:, 0],
                               flat, atol=1e-15)


def test_a_window_in_the_light_adds_a_constant_and_a_wedge_bends():
    p, R = poses(50, turn=1e-5)
    base, glass, thickness = sensor.station(MACHINE, setup('ppp')), 1.5168, 0.004
    front = Plane((0.0, 0.0, 0.05), (0.0, 0.0, -1.0))

    def behind(normal):
        window = Body.glass('window', glass, front, Plane((0.0, 0.0, 0.05 + thickness), normal))
        return SensorScene(base.origin, base.triad, 0.35, LAYOUT_A, (0.02, 0.0), [window])
    bare = SensorScene(base.origin, base.triad, 0.35, LAYOUT_A, (0.02, 0.0)).measure(p, R)
    window = behind((0.0, 0.0, 1.0)).measure(p, R)
    np.testing.assert_allclose(window.distance - bare.distance, (glass - 1) * thickness, atol=1e-14)
    wedge = behind((1e-3, 0.0, 1.0)).measure(p, R)
    bend = (glass - 1) * 1e-3
    # The wedge turns the beam by (n−1)·wedge about v, on the way out and again on the way home.
    lateral = np.linalg.norm((wedge.spot - bare.spot), axis=1) / (2 * bare.distance[:, 0])
    assert np.allclose(lateral, bend, rtol=0.1)


def test_bodies_that_block_the_light_are_an_error():
    base = sensor.station(MACHINE, setup('ppp'))
    screen = Body.detector('screen', Plane((0.0, 0.0, 0.1), (0.0, 0.0, -1.0)))
    with pytest.raises(ValueError, match='does not reach the mirror'):
        SensorScene(base.origin, base.triad, 0.35, bodies=[screen])


def test_beam_lines_run_from_the_base_unit_to_the_mirror_and_back():
    p, R = poses(3)
    scene = SensorScene.of_setup(MACHINE, setup('ppp'))
    lines = scene.beam_lines(p, R, beam_tilt=LASER)
    reading = scene.measure(p, R, beam_tilt=LASER)
    assert [len(line) for line in lines] == [2, 2, 2, 3]
    for number in range(3):
        length = np.linalg.norm(lines[number][1] - lines[number][0], axis=1)
        np.testing.assert_allclose(length, reading.distance[:, number], atol=1e-15)
    offset = (lines[3][-1] - lines[3][0]) @ scene.triad.T
    np.testing.assert_allclose(offset[:, :2], reading.spot, atol=1e-15)
