"""The runner drives a control that answers, one that never arrives, and one that fails."""

import time
from contextlib import contextmanager

import numpy as np
import pytest

from stepdiag_ros.devices.base import DeviceError
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.log import DONE, DWELL, MOVE
from stepdiag_ros.nodes.run_plan import Run, Stop, once_more
from stepdiag_ros.nodes.runner import Cancelled, Interrupted, Runner


class Control:
    """Arrives after two questions; remembers what it was told."""

    def __init__(self, fail_at: int | None = None, arrives: bool = True, stops: bool = True):
        self.moves, self.stopped, self.questions = [], 0, 0
        self._fail_at, self._arrives, self._stops = fail_at, arrives, stops

    def move(self, position_m, feed_m_s):
        if len(self.moves) == self._fail_at:
            raise DeviceError('machine control at x:1: dropped the connection; reconnect')
        self.moves.append(np.array(position_m))
        self.questions = 0

    def in_position(self):
        self.questions += 1
        return self._arrives and self.questions > 2

    def stop(self):
        self.stopped += 1
        if not self._stops:
            raise DeviceError('machine control at x:1: does not come to rest')


class Hall:
    """Everything around the runner, on record."""

    def __init__(self, control: Control, **changes):
        self.events, self.mounted, self.resets, self.progress = [], [], 0, []
        self.cancel_after = None
        self.runner = Runner(
            control, self._announce, self.mounted.append, self._reset,
            changes.pop('check', lambda setup: None), changes.pop('caught_up', lambda setup, time_ns: None),
            self.progress.append, self._cancelled, changes.pop('again', self._never), lambda stop: None, time.time_ns,
            feed_m_s=0.1, dwell_s=0.005, guard_s=0.001, **changes)

    def _announce(self, run, stop, phase, time_ns):
        self.events.append((run.run_id, stop.index, phase, time_ns))

    @staticmethod
    def _never(run, error):
        raise error

    def _reset(self):
        self.events.append(('reset',))
        self.resets += 1

    def _cancelled(self):
        return self.cancel_after is not None and len(self.events) >= self.cancel_after


def runs() -> list[Run]:
    stops = (Stop(0, 255, np.zeros(3)), Stop(1, 0, np.array([0.1, 0, 0])))
    back = (Stop(1, 255, np.array([0.1, 0, 0])), Stop(0, 0, np.zeros(3)))
    return [Run('lin_x/0/+', 'lin_x', 0, 1, stops), Run('lin_x/0/-', 'lin_x', 0, -1, back)]


def test_every_stop_is_move_dwell_done_after_a_reset_at_the_first():
    control = Control()
    hall = Hall(control)
    outcome = hall.runner.execute(runs())
    assert outcome.run_ids == ('lin_x/0/+', 'lin_x/0/-') and outcome.stops == 4
    assert hall.mounted == ['lin_x']
    shape = [event[:3] for event in hall.events]
    assert shape[:7] == [('reset',), ('lin_x/0/+', 0, MOVE), ('lin_x/0/+', 0, DWELL),
                         ('lin_x/0/+', 0, DONE), ('lin_x/0/+', 1, MOVE), ('lin_x/0/+', 1, DWELL),
                         ('lin_x/0/+', 1, DONE)]
    times = [event[3] for event in hall.events if len(event) == 4]
    assert times == sorted(times)
    dwells = [(e[3], d[3]) for e, d in zip(hall.events, hall.events[1:], strict=False)
              if len(e) == 4 and len(d) == 4 and (e[2], d[2]) == (DWELL, DONE)]
    assert len(dwells) == 4 and all(done - dwell >= 4_000_000 for dwell, done in dwells)
    assert control.stopped == 1


def test_progress_names_what_moves_and_ends_at_all_stops():
    hall = Hall(Control())
    hall.runner.execute(runs())
    assert any(p.axis == 0 and p.doing == 'X to stop 1 of 1' for p in hall.progress)
    assert hall.progress[-1].done == hall.progress[-1].total == 4
    assert hall.progress[-1].time_left_s == 0.0


def test_the_first_dwell_after_a_mounting_may_be_longer():
    hall = Hall(Control(), stand_s=0.2)
    hall.runner.execute(runs())
    times = {event[:3]: event[3] for event in hall.events if len(event) == 4}
    dwells = [times[run, stop, DONE] - times[run, stop, DWELL] for run, stop in (
        ('lin_x/0/+', 0), ('lin_x/0/+', 1), ('lin_x/0/-', 1), ('lin_x/0/-', 0))]
    assert dwells[0] >= 200_000_000 and max(dwells[1:]) < dwells[0]


def test_the_light_is_held_from_zero_to_the_last_stop_and_by_no_other_move():
    """Mounting (and whoever is waited for in it), the approach and the way to the next run are made without it."""
    order = []

    @contextmanager
    def light(run, expected_s):
        order.append(('has it', run.run_id))
        yield
        order.append(('gives it back', run.run_id))
    control = Control()
    hall = Hall(control, light=light)
    move, announce = control.move, hall.runner.announce
    control.move = lambda position_m, feed_m_s: (order.append('move'), move(position_m, feed_m_s))
    hall.runner.mount = lambda setup: order.append('mounts')
    hall.runner.reset = lambda: order.append('zero')
    hall.runner.announce = lambda run, stop, phase, time_ns: (
        order.append('done') if phase == DONE else None, announce(run, stop, phase, time_ns))
    hall.runner.execute(runs())
    forward, back = ([('has it', f'lin_x/0/{way}'), 'zero', 'done', 'move', 'done', ('gives it back', f'lin_x/0/{way}')]
                     for way in '+-')
    assert order == ['mounts', 'move', *forward, 'move', *back]


def test_cancel_stops_the_axes_and_says_what_was_done():
    control = Control()
    hall = Hall(control)
    hall.cancel_after = 5
    with pytest.raises(Cancelled) as caught:
        hall.runner.execute(runs())
    assert control.stopped == 1
    assert caught.value.outcome.stops == 1 and caught.value.outcome.run_ids == ()


def test_a_lost_control_ends_the_runs():
    control = Control(fail_at=2)
    with pytest.raises(StepdiagError, match='dropped the connection') as caught:
        Hall(control).runner.execute(runs())
    assert control.stopped == 1 and caught.value.outcome.run_ids == ('lin_x/0/+',)


def test_a_control_that_cannot_be_stopped_is_said():
    hall = Hall(Control(stops=False))
    hall.cancel_after = 2
    with pytest.raises(StepdiagError, match='could not be stopped.*does not come to rest'):
        hall.runner.execute(runs())


def test_an_axis_that_never_arrives_is_given_up():
    hall = Hall(Control(arrives=False), move_timeout_s=0.02)
    with pytest.raises(StepdiagError, match='does not report in position at stop 0'):
        hall.runner.execute(runs())


def test_a_silent_source_ends_the_runs():
    def check(setup):
        raise StepdiagError('/m/psd/spot has been silent for 3.0 s')
    with pytest.raises(StepdiagError, match='silent') as caught:
        Hall(Control(), check=check).runner.execute(runs())
    assert caught.value.outcome.stops == 0   # it was not done when the source fell silent


def test_a_source_lost_at_a_runs_last_stop_ends_it_before_the_next_zero():
    waited = []

    def caught_up(setup, time_ns):
        waited.append((setup, time_ns))
        raise StepdiagError('/m/psd/spot has been silent for 3.0 s')
    hall = Hall(Control(), caught_up=caught_up)
    with pytest.raises(StepdiagError, match='silent') as caught:
        hall.runner.execute(runs())
    assert waited == [('lin_x', hall.events[-1][3])] and hall.events[-1][2] == DONE
    assert caught.value.outcome.run_ids == () and hall.resets == 1


class Sudden(Exception):
    """Nobody foresaw this one."""


@pytest.mark.parametrize('raised', [Sudden('boom'), RuntimeError('boom'), KeyboardInterrupt(), MemoryError()])
def test_any_exception_stops_the_machine(raised):
    def check(setup):
        raise raised
    control = Control()
    with pytest.raises(type(raised)):
        Hall(control, check=check).runner.execute(runs())
    assert control.stopped == 1


def test_an_interrupted_run_is_repeated_after_the_machine_stood_and_was_mounted_anew():
    broken, waited = [Interrupted('/m/psd/spot is silent')], []
    control = Control()

    def check(setup):
        if len(hall.events) > 9 and broken:
            raise broken.pop()

    def again(run, error):
        waited.append((run.run_id, str(error), control.stopped))
        return once_more(run)
    hall = Hall(control, check=check, again=again)
    outcome = hall.runner.execute(runs())
    assert waited == [('lin_x/0/-', '/m/psd/spot is silent', 1)]
    assert outcome.run_ids == ('lin_x/0/+', 'lin_x/0/-/2') and outcome.stops == 4
    assert hall.mounted == ['lin_x', 'lin_x'] and hall.resets == 3
    assert control.stopped == 2 and hall.progress[-1].done == 4


def test_what_cannot_be_repeated_ends_the_calibration_with_the_machine_stopped():
    control = Control()

    def check(setup):
        raise Interrupted('gone')
    with pytest.raises(Interrupted, match='gone') as caught:
        Hall(control, check=check).runner.execute(runs())
    assert control.stopped == 2 and caught.value.outcome.stops == 0


@pytest.mark.parametrize(('mid_move', 'stops'), [(False, 1), (True, 0)])
def test_a_lost_client_ends_the_run_at_the_next_stop_or_at_once(mid_move, stops):
    control = Control()
    hall = Hall(control)

    def attended(stop):
        if hall.resets and (stop or mid_move):
            raise StepdiagError('the client is lost')
    hall.runner.attended = attended
    with pytest.raises(StepdiagError, match='client is lost') as caught:
        hall.runner.execute(runs())
    assert caught.value.outcome.stops == stops and control.stopped == 1
