"""Ibaraki & Hiruya: the path, Table 5, what is given back, and the shape of fig. 12."""

from dataclasses import replace

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import multilateration as ml
from stepdiag_ros.estimate import regulated_beam as rb

TEST = rb.published_test()


def test_path_has_the_published_numbers():
    path = rb.rectangular_path()
    assert path.shape == (53, 2)
    assert np.abs(path).max() == 0.4
    assert np.all(np.isclose(np.abs(np.diff(path, axis=0)).sum(axis=1), 0.1))
    assert np.all(path[0] == 0.0)
    assert len(np.unique(np.round(path[:, 0], 9))) == len(np.unique(np.round(path[:, 1], 9))) == 9
    outline = {tuple(p) for p in np.round(path[np.abs(path).max(axis=1) > 0.399], 9)}
    assert len(outline) == 32


def test_table_5():
    budget = rb.Budget()
    assert budget.length * 1e6 == pytest.approx(0.65, abs=0.007)
    assert budget.interferometer * 1e6 == pytest.approx(2.12)
    assert budget.angle * 1e4 == pytest.approx(np.sqrt(2.88**2 + 0.18**2 + 6.73**2 + 0.34**2))
    distance = np.linalg.norm(np.array([-0.4, -0.4]) - TEST.eyes[2])
    assert budget.orientation(distance) * 1e6 == pytest.approx(0.14)
    # Which is where P3 was taken from: half a metre beyond the corner.
    assert 0.45 < distance < 0.6


def test_equation_4_points_at_the_eye():
    points = np.array([[0.0, 0.0], [0.3, -0.1]])
    for eye in ([0.0, 2.0], [-0.7, 0.9], [-0.7, -0.8]):
        angle = rb.c_angle(eye, points)
        beam = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
        arm = np.array(eye) - points
        np.testing.assert_allclose(beam * np.linalg.norm(arm, axis=1)[:, None], arm, atol=1e-14)


def made_up(seed=3):
    """Readings of a machine with known motions, the eye 5 mm off its guess."""
    problem = rb.problem_of(TEST, rb.nominal_readings(TEST))
    unknown = problem.initial()
    unknown[:problem.motions] = np.random.default_rng(seed).normal(0.0, 5e-6, problem.motions)
    unknown[problem.motions:problem.motions + 2] += [0.004, -0.003]
    reading = problem.predict(unknown)
    return problem, unknown, [reading[problem.station == k] - reading[problem.station == k][0]
                              for k in range(3)]


def test_gives_back_the_motions_the_eye_and_the_dead_path():
    problem, unknown, readings = made_up()
    answer = ml.solve(rb.problem_of(TEST, readings))
    assert answer.converged
    assert len(answer.null) == 0
    np.testing.assert_allclose(answer.unknown[:problem.motions], unknown[:problem.motions], atol=1e-13)
    found = rb.evaluate(TEST, readings)
    np.testing.assert_allclose(found.extra['stations_m'][2], TEST.eyes[2] + [0.004, -0.003], atol=1e-12)
    place, value, _ = found.curve('ECX')
    np.testing.assert_allclose(value, rb.motions_of(TEST).curve_rows('ECX') @ unknown[:problem.motions],
                               atol=1e-13)
    assert value[np.argmin(np.abs(place))] == 0.0
    assert found.has('EC0Y')


def test_lines_off_the_origin_are_general():
    """Remark of section 2.3: with y_a ≠ 0 the line reads EXX − ECX·y_a, and is still solved."""
    test = replace(TEST, y_a=0.2, eyes=TEST.eyes + [[0.0, 0.2], [0.0, 0.0], [0.0, 0.0]])
    problem = rb.problem_of(test, rb.nominal_readings(test))
    unknown = problem.initial()
    unknown[:problem.motions] = np.random.default_rng(1).normal(0.0, 5e-6, problem.motions)
    reading = problem.predict(unknown)
    answer = ml.solve(rb.problem_of(test, [reading[problem.station == k] for k in range(3)]))
    np.testing.assert_allclose(answer.unknown[:problem.motions], unknown[:problem.motions], atol=1e-13)


def on_grid(values):
    """(9, 9) with rows y from −400 to 400, columns x."""
    return values.reshape(9, 9).T


def test_shape_of_figure_12():
    _, drawn, linear = rb.position_uncertainty(TEST, 10_000)
    table = on_grid(drawn)
    assert table[4, 4] == pytest.approx(0.0, abs=1e-12)
    # Small along y = 0: in every column that row is the least.
    assert np.all(table[4] <= table.min(axis=0) + 1e-12)
    corners = {(x, y): table[8 * (y > 0), 8 * (x > 0)] for x in (-1, 1) for y in (-1, 1)}
    # Largest at (∓400, ±400).
    assert sorted(corners, key=corners.get)[2:] == sorted([(-1, 1), (1, -1)], key=corners.get)
    assert table.max() == max(corners.values())
    np.testing.assert_allclose(drawn[linear > 1e-12], linear[linear > 1e-12], rtol=0.04)


def test_frame_on_the_last_point_leans():
    """Eq. 8 to the letter: the frame hangs on x = +400, the far side pays."""
    _, _, line = rb.position_uncertainty(TEST, 100)
    _, _, end = rb.position_uncertainty(TEST, 100, frame='end point')
    line, end = on_grid(line), on_grid(end)
    assert end[8, 0] > line[8, 0]
    assert end[4, 8] < line[4, 8]


def test_bad_input_is_named():
    with pytest.raises(StepdiagError, match=r'lengths \[9, 9, 52\], expected \[9, 9, 53\]'):
        rb.problem_of(TEST, [np.zeros(9), np.zeros(9), np.zeros(52)])
    with pytest.raises(StepdiagError, match='take an odd number'):
        rb.rectangular_path(count=8)
    with pytest.raises(StepdiagError, match='frame='):
        rb.position_uncertainty(TEST, 10, frame='other')
