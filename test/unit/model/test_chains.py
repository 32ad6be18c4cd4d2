"""Kinematic chains: derived a second time with exact rotations, and against Wang & Liotto's angular terms."""

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stepdiag_ros.model.machine import AXES, compose
from stepdiag_ros.model.optics import Body, Plane, Scene
from stepdiag_ros.model.rays import components

CHAINS = [''.join(letters) for letters in permutations('FXYZ')]
EXPLANATION = Path(__file__).parents[3] / 'docs' / 'explanation' / 'chains.md'


def frame(rotation, translation):
    """Homogeneous matrix of a body whose own points ``q`` are at ``rotation·q + translation``."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation
    return matrix


def exact_pose(chain, shifts, turns, tool):
    """Tool in the workpiece's frame from rigid bodies one on another, rotations exact.

    Seen from the machine's frame F a slide on the tool's side makes the motion itself, a table under
    the workpiece the opposite one: what is stated is the tool's motion relative to the workpiece.
    """
    place = chain.index('F')
    to_tool, to_workpiece = np.eye(4), np.eye(4)
    for letter in chain[place + 1:]:
        axis = AXES.index(letter)
        to_tool = to_tool @ frame(Rotation.from_rotvec(turns[axis]).as_matrix(), shifts[axis])
    for letter in reversed(chain[:place]):
        axis = AXES.index(letter)
        to_workpiece = to_workpiece @ frame(Rotation.from_rotvec(-turns[axis]).as_matrix(), -shifts[axis])
    relative = np.linalg.inv(to_workpiece) @ to_tool @ frame(np.eye(3), tool)
    return relative[:3, 3], relative[:3, :3]


@pytest.mark.parametrize('chain', CHAINS)
def test_every_chain_is_the_exact_one_to_second_order(chain):
    rng = np.random.default_rng(1)
    shifts = np.diag([0.8, 0.6, 0.5]) + rng.normal(0, 1e-5, (3, 3))
    turns, tool = rng.normal(0, 1.0, (3, 3)), np.array([0.02, -0.03, -0.15])
    off = []
    for size in (1e-3, 1e-4, 1e-5):
        want, attitude = exact_pose(chain, shifts, size * turns, tool)
        got, turned = compose(chain, shifts[:, None], size * turns[:, None], tool)
        off.append(np.linalg.norm(got[0] - want))
        assert np.abs(turned[0] - attitude).max() < 20 * size**2
        assert off[-1] < 10 * size**2
    # A wrong sign anywhere would leave a first-order difference: ten times less, not a hundred.
    assert off[0] / off[1] == pytest.approx(100, rel=0.02)
    assert off[1] / off[2] == pytest.approx(100, rel=0.05)


def angular_terms(chain, signs, step=(0.3, 0.5, 0.7), reading=None):
    """Coefficients of EA, EB, EC of every axis in the reading along a diagonal, in units of bc/r, ac/r, ab/r.

    Positions count from the diagonal's first corner, as the paper has them.
    """
    step = np.array(signs) * step
    r = np.linalg.norm(step)
    direction = step / r
    units = np.abs([step[1] * step[2], step[0] * step[2], step[0] * step[1]]) / r
    reading = reading or (lambda point: point @ direction)
    shifts = np.diag(step)[:, None]
    table = np.zeros((3, 3))
    for axis in range(3):
        for motion in range(3):
            both = []
            for size in (1e-6, -1e-6):
                turns = np.zeros((3, 1, 3))
                turns[axis, 0, motion] = size
                both.append(reading(compose(chain, shifts, turns, np.zeros(3))[0][0]))
            table[axis, motion] = (both[0] - both[1]) / 2e-6 / units[motion]
    return table


# Rows: X, Y, Z; columns: rotation about x [bc/r], y [ac/r], z [ab/r].  Equations 1 to 4, FXYZ.
PRINTED_FXYZ = {
    (1, 1, 1): [[0, 1, -1], [-1, 1, 0], [0, 0, 0]],
    (-1, 1, 1): [[0, -1, 1], [-1, -1, 0], [0, 0, 0]],
    (1, -1, 1): [[0, 1, 1], [1, 1, 0], [0, 0, 0]],
    (1, 1, -1): [[0, -1, -1], [1, -1, 0], [0, 0, 0]],
}


@pytest.mark.parametrize('signs', PRINTED_FXYZ)
def test_equations_1_to_4_come_out_of_the_chain(signs):
    np.testing.assert_allclose(angular_terms('FXYZ', signs), PRINTED_FXYZ[signs], atol=1e-8)


@pytest.mark.parametrize('signs', PRINTED_FXYZ)
def test_equations_1_to_4_come_out_of_a_traced_retroreflector(signs):
    """The reading of a traced beam into a hollow corner cube at the tool, nothing linearised."""
    direction = np.array(signs) * (0.3, 0.5, 0.7)
    direction /= np.linalg.norm(direction)
    start = -0.5 * direction
    turn = Rotation.align_vectors([-direction], [np.ones(3) / np.sqrt(3.0)])[0].as_matrix()

    def reading(point):
        mirrors = [Body.mirror(f'm{k}', Plane(tuple(point), tuple(turn[:, k]))) for k in range(3)]
        scene = Scene((*mirrors, Body.detector('end', Plane(tuple(start), tuple(direction)))))
        offset = 0.004 * np.cross(direction, [0.2, 0.3, -0.9])
        path = scene.find_path(components(start + offset), components(direction))
        assert len(path) == 4
        return scene.trace(path, components(start + offset), components(direction)).optical_path[-1] / 2.0

    np.testing.assert_allclose(angular_terms('FXYZ', signs, reading=reading), PRINTED_FXYZ[signs], atol=1e-7)


def test_printed_term_of_xfyz_comes_out():
    """``Ay(y) ac/r − Ax(y) bc/r``: the table's own rotations drop out on the diagonal."""
    np.testing.assert_allclose(angular_terms('XFYZ', (1, 1, 1)), [[0, 0, 0], [-1, 1, 0], [0, 0, 0]], atol=1e-8)


def test_printed_term_of_xyfz_cannot_be_that_of_a_rigid_machine():
    """``Ax(x) bc/r − Ay(x) ac/r + Az(x) ab/r`` is printed; what comes out has two terms and belongs to y."""
    got = angular_terms('XYFZ', (1, 1, 1))
    np.testing.assert_allclose(got, [[0, 0, 0], [0, 1, -1], [0, 0, 0]], atol=1e-8)
    a, b, c = 0.3, 0.5, 0.7
    # A lever q turned by ω reads d·(ω×q) = ω·(q×d): its coefficients are orthogonal to d, whatever q is.
    def along_diagonal(row):
        return np.dot(np.array(row) * [b * c, a * c, a * b], [a, b, c])
    for chain in CHAINS:
        for row in angular_terms(chain, (1, 1, 1)):
            assert abs(along_diagonal(row)) < 1e-8
    assert along_diagonal([1, -1, 1]) == pytest.approx(a * b * c)
    # Without its roll term, read as a table's own motion (opposite signs) and of y, the print is right.
    np.testing.assert_allclose(-got[1], [0, -1, 1], atol=1e-8)


def terms_in_words(chain):
    names, units = 'ABC', ('bc/r', 'ac/r', 'ab/r')
    parts = [f'{"+" if value > 0 else "−"} E{names[motion]}{axis}·{units[motion]}'
             for axis, row in zip(AXES, angular_terms(chain, (1, 1, 1)), strict=True)
             for motion, value in enumerate(row) if abs(value) > 0.5]
    return ' '.join(parts).removeprefix('+ ') or 'none'


def test_the_explanation_lists_every_chain_as_it_is():
    text = EXPLANATION.read_text(encoding='utf-8')
    for chain in CHAINS:
        assert f'| {chain} | {terms_in_words(chain)} |' in text
