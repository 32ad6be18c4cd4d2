"""The stops of a goal: order, directions, names of the runs."""

import numpy as np
import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import Description, Machine, Plan, Setup
from stepdiag_ros.model.log import NONE
from stepdiag_ros.nodes.run_plan import Run, attempt, first_repeats, planned_runs, remaining, with_steps


@pytest.fixture
def description() -> Description:
    setups = {'npp': Setup('npp', 0.2, (0.02, 0.0), ((0.0, 0.0),)),
              'lin_y': Setup('lin_y', 0.2, (0.02, 0.0), ((0.0, 0.0),), 0.2, 3)}
    return Description(Machine('m', 'FXYZ', (0.4, 0.2, 0.1), (0.0, 0.0, -0.1)),
                       Plan(2, 'XYZ', 2), setups)


def test_forward_then_backward_for_each_repeat(description):
    runs = planned_runs(description)
    assert [run.run_id for run in runs] == [
        'npp/0/+', 'npp/0/-', 'npp/1/+', 'npp/1/-', 'lin_y/0/+', 'lin_y/0/-', 'lin_y/1/+', 'lin_y/1/-']


def test_a_diagonal_zigzags_from_its_corner(description):
    forward = planned_runs(description, ['npp'])[0]
    assert [stop.index for stop in forward.stops] == list(range(7))
    assert [stop.axis for stop in forward.stops] == [NONE, 0, 1, 2, 0, 1, 2]
    np.testing.assert_allclose(forward.stops[0].position_m, [0.4, 0.0, 0.0])
    np.testing.assert_allclose(forward.stops[-1].position_m, [0.0, 0.2, 0.1])


def test_backward_names_the_axis_of_the_step_between_two_stops(description):
    backward = planned_runs(description, ['npp'])[1]
    assert backward.direction == -1
    assert [stop.index for stop in backward.stops] == list(range(6, -1, -1))
    assert [stop.axis for stop in backward.stops] == [NONE, 2, 1, 0, 2, 1, 0]
    moved = np.diff([stop.position_m for stop in backward.stops], axis=0)
    assert [int(np.argmax(np.abs(step))) for step in moved] == [2, 1, 0, 2, 1, 0]


def test_repeats_count_on_in_one_bag(description):
    runs = planned_runs(description, ['lin_y'], repeats=1, first_repeat={'lin_y': 2})
    assert [run.run_id for run in runs] == ['lin_y/2/+', 'lin_y/2/-']


def test_unknown_and_doubled_setups_are_refused(description):
    with pytest.raises(StepdiagError, match="unknown setup 'ppp'.*npp, lin_y"):
        planned_runs(description, ['ppp'])
    with pytest.raises(StepdiagError, match='named twice'):
        planned_runs(description, ['npp', 'npp'])


def test_other_steps(description):
    assert with_steps(description, 0) is description
    assert len(planned_runs(with_steps(description, 5), ['npp'])[0].stops) == 16


def test_what_is_left_of_a_calibration_that_another_sequencer_began():
    runs = [Run(f'ppp/{repeat}/{sign}', 'ppp', repeat, 1, ()) for repeat in (3, 4) for sign in '+-']
    left = remaining(runs, ['ppp/3/+/2'], 'ppp/3/-')
    assert [run.run_id for run in left] == ['ppp/3/-/2', 'ppp/4/+', 'ppp/4/-']
    again = remaining(runs, ['ppp/3/+'], 'ppp/3/-/2')
    assert again[0].run_id == 'ppp/3/-/3' and attempt(again[0].run_id) == 3
    assert [run.run_id for run in remaining(runs, [], '')] == [run.run_id for run in runs]
    assert first_repeats(['ppp/4/+', 'ppp/3/-/2', 'lin_x/0/+', '']) == {'ppp': 3, 'lin_x': 0}
