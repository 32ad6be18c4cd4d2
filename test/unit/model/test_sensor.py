"""The closed forms of the contract at cases that can be done by hand."""

import numpy as np
import pytest

from stepdiag_ros.model.description import Machine, Setup
from stepdiag_ros.model.machine import rotation
from stepdiag_ros.model.sensor import Misalignment, measure, station, turned

MACHINE = Machine('m', 'FXYZ', (0.8, 0.6, 0.5), (0.01, -0.02, -0.15))
SETUP = Setup('npp', 0.35, (0.02, 0.01), ((0.0, 0.0), (0.03, 0.0)))


def pose(along=0.4, turn=(0.0, 0.0)):
    """Mirror ``along`` the beam from the base unit, turned about (u, v)."""
    base = station(MACHINE, SETUP)
    angle = np.array(turn) @ base.triad[:2]
    return base, (base.origin + along * base.triad[2])[None], rotation(angle[None])


def test_a_square_mirror_reads_its_distance():
    _, point, attitude = pose(0.7)
    length, spot = measure(MACHINE, SETUP, Misalignment(), point, attitude)
    np.testing.assert_allclose(length, [[0.7, 0.7]], atol=1e-15)
    np.testing.assert_allclose(spot, 0.0, atol=1e-15)


def test_the_spot_follows_the_turn_as_the_contract_says():
    alpha, beta = 2e-5, -3e-5
    _, point, attitude = pose(0.7, (alpha, beta))
    _, spot = measure(MACHINE, SETUP, Misalignment(), point, attitude)
    assert spot[0] == pytest.approx([-2 * 0.7 * beta, 2 * 0.7 * alpha], rel=1e-3)
    # A mount turned in the tool and a tool turned with its mirror look the same.
    _, point, straight = pose(0.7)
    _, mounted = measure(MACHINE, SETUP, Misalignment(mirror=(alpha, beta)), point, straight)
    np.testing.assert_allclose(mounted, spot, atol=1e-13)


def test_a_beam_beside_sees_the_turn_in_its_length():
    beta = 1e-5
    _, point, attitude = pose(0.7, (0.0, beta))
    length, _ = measure(MACHINE, SETUP, Misalignment(), point, attitude)
    # Turning about v moves what lies along +u towards −d.
    assert length[0, 1] - length[0, 0] == pytest.approx(-0.03 * beta, rel=1e-4)


def test_a_turned_laser_reads_longer_to_second_order():
    _, point, attitude = pose(0.7)
    length, _ = measure(MACHINE, SETUP, Misalignment(laser=(1e-3, 0.0)), point, attitude)
    assert length[0, 0] - 0.7 == pytest.approx(0.7 * 0.5e-6, rel=1e-3)


def test_turned_directions_are_unit_and_of_the_right_sign():
    base = station(MACHINE, SETUP)
    u, v, d = base.triad
    both = turned(base.triad, np.array([[1e-3, 0.0], [0.0, 1e-3]]))
    np.testing.assert_allclose(np.linalg.norm(both, axis=1), 1.0, rtol=1e-15)
    np.testing.assert_allclose(both[0] - d, -1e-3 * v, atol=1e-6)
    np.testing.assert_allclose(both[1] - d, 1e-3 * u, atol=1e-6)
