"""Setups and their stops, as the contract has them."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import DIAGONALS, LINEAR, Description, Machine, Plan, Setup
from stepdiag_ros.model.path import local_triad, plan_positions, setup_direction, start_corner, stops

MACHINE = Machine('m', 'FXYZ', (0.7, 0.3, 0.9), (0.0, 0.0, -0.1))


@pytest.fixture
def description():
    setups = {name: Setup(name, 0.3, (0.02, 0.0), ((0.0, 0.0),)) for name in DIAGONALS}
    setups |= {name: Setup(name, 0.3, (0.02, 0.0), ((0.0, 0.0),), 0.25, 3) for name in LINEAR}
    return Description(MACHINE, Plan(7, 'XYZ', 1), setups)


@pytest.mark.parametrize(('name', 'start'), [('ppp', (0, 0, 0)), ('npp', (0.7, 0, 0)), ('pnp', (0, 0.3, 0)),
                                             ('nnp', (0.7, 0.3, 0))])
def test_diagonals_climb_to_the_opposite_corner(description, name, start):
    path = stops(description, name)
    assert len(path) == 22
    assert tuple(path.positions[0]) == start
    assert np.array_equal(path.positions[-1], [0.7 - start[0], 0.3 - start[1], 0.9])
    assert path.axis.tolist() == [255, *([0, 1, 2] * 7)]
    moved = np.diff(path.positions, axis=0) != 0.0
    assert np.array_equal(moved.argmax(axis=1), path.axis[1:])
    assert np.all(moved.sum(axis=1) == 1)
    travel = path.positions[-1] - path.positions[0]
    np.testing.assert_allclose(setup_direction(MACHINE, name), travel / np.linalg.norm(travel))
    assert np.array_equal(start_corner(MACHINE, name), start)


def test_the_order_of_the_axes_is_the_plans(description):
    turned = replace(description, plan=Plan(2, 'ZXY', 1))
    assert stops(turned, 'ppp').axis.tolist() == [255, 2, 0, 1, 2, 0, 1]


def test_lines_have_stops_of_their_own(description):
    path = stops(description, 'lin_y')
    np.testing.assert_allclose(path.positions, [[0, 0, 0], [0, 0.125, 0], [0, 0.25, 0]])
    assert path.axis.tolist() == [255, 1, 1]
    assert np.array_equal(setup_direction(MACHINE, 'lin_y'), [0, 1, 0])


@pytest.mark.parametrize('name', [*DIAGONALS, *LINEAR])
def test_triads_are_right_handed(name):
    u, v, d = local_triad(setup_direction(MACHINE, name))
    np.testing.assert_allclose(np.cross(u, v), d, atol=1e-15)
    np.testing.assert_allclose([u @ u, v @ v, u @ v, u @ d], [1, 1, 0, 0], atol=1e-15)
    if name == 'lin_z':
        assert np.array_equal(u, [1, 0, 0])
    else:
        assert u[2] == 0.0


def test_unknown_setups_and_plan_positions(description):
    with pytest.raises(StepdiagError, match="'ppn' is not in the cell description"):
        stops(description, 'ppn')
    np.testing.assert_allclose(plan_positions(description, 2), np.arange(8) * 0.9 / 7)


def test_a_setup_that_is_mounted_again_keeps_its_path():
    from stepdiag_ros.model.description import Description, path_of
    text = ('schema: 1\nmachine: {volume: [0.5, 0.4, 0.3]}\nplan: {steps: 2}\n'
            'setups: {npp: {}, npp.2: {standoff: 0.4}, lin_y.2: {}}\n')
    again = Description.from_yaml(text, 'test')
    assert [path_of(name) for name in ('npp.2', 'lin_x', 'npp.b')] == ['npp', 'lin_x', 'npp.b']
    np.testing.assert_array_equal(stops(again, 'npp').positions, stops(again, 'npp.2').positions)
    assert again.setups['lin_y.2'].is_linear and stops(again, 'lin_y.2').positions[-1, 1] == 0.4
    assert Description.from_yaml(again.to_yaml(), 'test') == again
