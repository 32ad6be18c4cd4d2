"""Reference lines: equal machines look equal, whichever way their straightness is written."""

import numpy as np
import pytest

from stepdiag_ros.estimate.gauge import (
    SLOPES,
    STRAIGHTNESS,
    reporting_matrix,
    slope_weights,
    to_reference_lines,
)
from stepdiag_ros.estimate.planned import observe, planned_table
from stepdiag_ros.model.machine import CURVES, Curve, GeometricErrors


def tilted(errors, name, slope):
    """A machine with a slope more in one straightness curve and the squareness that cancels it."""
    curves = dict(errors.curves)
    curve = curves[name]
    curves[name] = Curve(curve.position, curve.value + slope * curve.position)
    square = dict(errors.square)
    for angle, parts in SLOPES.items():
        for part, sign in parts:
            if part == name:
                square[angle] -= sign * slope
    return GeometricErrors(curves, square)


@pytest.mark.parametrize('name', STRAIGHTNESS)
def test_the_answer_does_not_depend_on_the_way_it_is_written(plan_of, draw_errors, name):
    errors = draw_errors(plan_of().machine, 4, framed=False)
    one, two = to_reference_lines(errors), to_reference_lines(tilted(errors, name, 3e-5))
    for curve in CURVES:
        np.testing.assert_allclose(one.curves[curve].value, two.curves[curve].value, atol=1e-18)
    for angle in one.square:
        assert one.square[angle] == pytest.approx(two.square[angle], abs=1e-18)


@pytest.mark.parametrize('name', ['EXY', 'EXZ', 'EYZ'])
def test_slopes_of_these_curves_are_squareness_to_the_last_bit(plan_of, draw_errors, name):
    """No reading changes when the slope of a moved axis's straightness is called squareness."""
    description = plan_of()
    table, errors = planned_table(description), draw_errors(description.machine, 4)
    one = observe(description, table, errors)
    two = observe(description, table, tilted(errors, name, 3e-5))
    assert np.abs(one - two).max() < 1e-15


def test_turning_the_truth_is_seen_to_second_order_only(plan_of, draw_errors):
    """Slopes of EYX, EZX, EZY with their squareness turn the machine; its setups turn along."""
    description = plan_of()
    errors = draw_errors(description.machine, 4)
    turn = 2e-5
    turned = tilted(tilted(errors, 'EYX', turn), 'EXY', -turn)    # the frame about z
    one, two = to_reference_lines(errors), to_reference_lines(turned)
    for angle in one.square:
        assert one.square[angle] == pytest.approx(two.square[angle], abs=1e-18)


def test_lines_are_least_squares_and_done_twice_change_nothing(plan_of, draw_errors):
    found = to_reference_lines(draw_errors(plan_of().machine, 4, framed=False))
    for name in STRAIGHTNESS:
        curve = found.curves[name]
        assert curve.value[0] == 0.0
        assert abs(np.polyfit(curve.position, curve.value, 1)[0]) < 1e-18
    again = to_reference_lines(found)
    for name in CURVES:
        np.testing.assert_allclose(again.curves[name].value, found.curves[name].value, atol=1e-20)
    assert again.square == pytest.approx(found.square)


def test_the_matrix_does_the_same_as_the_function(plan_of, draw_errors):
    errors = draw_errors(plan_of().machine, 4, framed=False)
    errors = GeometricErrors(errors.curves, {})
    knots = {name: errors.curves[name].position for name in CURVES}
    first = {name: 4 * i for i, name in enumerate(CURVES)}
    names, matrix = reporting_matrix(knots, first, 72)
    got = matrix @ np.concatenate([errors.curves[name].value[1:] for name in CURVES])
    want = to_reference_lines(errors)
    for (name, knot), value in zip(names, got, strict=True):
        assert value == pytest.approx(want.square[name] if knot < 0 else want.curves[name].value[knot], abs=1e-18)


def test_slope_of_one_point_is_zero():
    assert slope_weights(np.array([0.3])) == [0.0]
    assert slope_weights(np.array([0.0, 0.5])) @ np.array([0.0, 1e-6]) == pytest.approx(2e-6)
