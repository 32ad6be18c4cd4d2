"""Drives a machine along planned runs and reports what it does.  Knows no ROS."""

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.devices.base import MotionController
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.log import DONE, DWELL, MOVE, NONE
from stepdiag_ros.nodes.run_plan import Run, Stop

POLL_S = 0.004
AXES = {0: 'X', 1: 'Y', 2: 'Z'}


class Cancelled(Exception):
    """Somebody asked to stop."""


class Interrupted(StepdiagError):
    """A run was broken off by what may pass: a node that is started again, an instrument that comes back."""


@dataclass(frozen=True)
class Progress:
    """Where a calibration is: stops done of all, what moves, seconds left, one phrase, runs completed."""

    run: Run
    done: int
    total: int
    axis: int
    time_left_s: float
    doing: str
    completed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """What was completed."""

    run_ids: tuple[str, ...]
    stops: int


@dataclass
class Runner:
    """Executes runs on a ready ``controller``.

    ``announce(run, stop, phase, time_ns)`` publishes a step event; ``mount(setup)`` has
    mirror, base unit and sensors put to a setup; ``reset()`` makes the present distance
    zero; ``check(setup)`` raises :class:`StepdiagError` when a source has fallen silent;
    ``caught_up(setup, time_ns)`` waits until all have delivered up to then, or raises so;
    ``report(progress)``; ``cancelled()``.  For ``guard_s`` after a dwell nothing moves: a
    sample that was polled a little later than its stamp says must not see the next move.
    The first dwell after a mounting lasts ``stand_s`` longer: it shows what goes on while nothing moves.
    After an :class:`Interrupted` run the machine stands; ``again(run, error)`` waits until it can be repeated
    and returns it under the name it then bears, or raises what ends the calibration.
    ``light(run, expected_s)``: a context in which a run has its light, which no other move needs.
    ``attended(stop)``: raises when the client is gone, ``stop``: a stop has been measured.
    However :meth:`execute` ends, by whatever exception, the machine is stopped.
    """

    controller: MotionController
    announce: Callable[[Run, Stop, int, int], None]
    mount: Callable[[str], None]
    reset: Callable[[], None]
    check: Callable[[str], None]
    caught_up: Callable[[str, int], None]
    report: Callable[[Progress], None]
    cancelled: Callable[[], bool]
    again: Callable[[Run, Interrupted], Run]
    attended: Callable[[bool], None]
    now_ns: Callable[[], int]
    feed_m_s: float
    dwell_s: float
    guard_s: float = 0.025
    stand_s: float = 0.0
    move_timeout_s: float = 120.0
    light: Callable[[Run, float], AbstractContextManager[None]] = lambda _run, _expected_s: nullcontext()

    def execute(self, runs: Sequence[Run]) -> Outcome:
        """All runs in order; what ends it early carries ``outcome``, what was completed until then."""
        self._total = sum(len(run.stops) for run in runs)
        self._done, self._completed = 0, []
        self._spent_s = 0.0
        self._mounted = None
        error: BaseException | None = None
        try:
            for run in runs:
                self._persist(run)
        except BaseException as caught:
            error = caught
            raise
        finally:
            if error is not None:
                error.outcome = self._outcome()
            self._hold(error)
        return self._outcome()

    def _outcome(self) -> Outcome:
        return Outcome(tuple(self._completed), self._done)

    def _hold(self, error: BaseException | None) -> None:
        """Stop the axes; a control that does not answer is the worse news of the two."""
        try:
            self.controller.stop()
        except StepdiagError as failed:
            worse = StepdiagError(f'{_word(error)}; and the machine could not be stopped: {failed}')
            worse.outcome = self._outcome()
            raise worse from None

    def _persist(self, run: Run) -> None:
        """One run, again where it was interrupted."""
        while True:
            done = self._done
            fresh = run.setup != self._mounted
            try:
                if fresh:
                    self._tell(run, NONE, f'mounting setup {run.setup}')
                    self.mount(run.setup)
                    self._mounted = run.setup
                self._traverse(run, self.stand_s if fresh else 0.0)
            except Interrupted as broken:
                self._hold(broken)
                self._done, self._mounted = done, None
                run = self.again(run, broken)
            else:
                self._completed.append(run.run_id)
                return

    def _traverse(self, run: Run, longer: float) -> None:
        """One run, its first dwell ``longer`` [s] than usual."""
        first = run.stops[0]
        self._tell(run, NONE, f'to the first stop of {run.run_id}')
        self._go(first)
        self._breathe()
        with self.light(run, longer + len(run.stops) * self._per_stop_s()):
            self._measure(run, first, longer)
        self._tell(run, NONE, f'{run.run_id} done')

    def _measure(self, run: Run, first: Stop, longer: float) -> None:
        """From the zero at the first stop to the last, in one light."""
        self.reset()
        for stop in run.stops:
            began, stand = time.monotonic(), longer if stop is first else 0.0
            if stop is first:
                self.announce(run, stop, MOVE, self.now_ns())
            else:
                self._tell(run, stop.axis, f'{AXES.get(stop.axis, "axes together")} to stop {stop.index} '
                                           f'of {len(run.stops) - 1}')
                self.announce(run, stop, MOVE, self.now_ns())
                self._go(stop)
            self.announce(run, stop, DWELL, self.now_ns())
            self._dwell(self.dwell_s + stand)
            # A stop is done when it was measured: by sources that lived, by a clock that went on.
            self.check(run.setup)
            done_ns = self.now_ns()
            self.announce(run, stop, DONE, done_ns)
            self._done += 1
            self._spent_s += time.monotonic() - began - stand
            self.attended(True)
            time.sleep(self.guard_s)
        # The next zero or setup forgives what was lost before it.
        self.caught_up(run.setup, done_ns)

    def _go(self, stop: Stop) -> None:
        """Move there, past the place beyond it where it has one, and wait until the control says in position."""
        if stop.beyond_m is not None:
            self._move(stop, stop.beyond_m)
        self._move(stop, stop.position_m)

    def _move(self, stop: Stop, position_m: np.ndarray) -> None:
        self._breathe()
        self.controller.move(position_m, min(self.feed_m_s, stop.most_m_s))
        end = time.monotonic() + self.move_timeout_s
        while not self.controller.in_position():
            self._breathe()
            if time.monotonic() > end:
                raise StepdiagError(f'the control does not report in position at stop {stop.index} '
                                    f'after {self.move_timeout_s:g} s; see its screen')
            time.sleep(POLL_S)

    def _dwell(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._breathe()
            time.sleep(min(left, 0.05))

    def _breathe(self) -> None:
        if self.cancelled():
            raise Cancelled
        self.attended(False)

    def _tell(self, run: Run, axis: int, doing: str) -> None:
        self.report(Progress(run, self._done, self._total, axis,
                             self._per_stop_s() * (self._total - self._done), doing, tuple(self._completed)))

    def _per_stop_s(self) -> float:
        return self._spent_s / self._done if self._done else self.dwell_s + 0.5


def _word(error: BaseException | None) -> str:
    """What ended a run, in words."""
    if error is None:
        return 'all was measured'
    if isinstance(error, Cancelled):
        return 'cancelled'
    return str(error) if isinstance(error, StepdiagError) else f'{type(error).__name__}: {error}'
