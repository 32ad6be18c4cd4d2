"""A cell that settles by itself what its log leaves open: diagnose, make the run that separates best, diagnose again.

Each further run goes into a bag of its own beside the first (``NAME_further_1`` …), as
``stepdiag gap NAME --further NAME_further_1`` reads them.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.effects.base import Effect
from stepdiag_ros.estimate.sanity_fit import must_be_sane
from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.gap.experiment_design.without_hands import Able, left_open, run_without_hands
from stepdiag_ros.model.joined import joined
from stepdiag_ros.nodes.operator import Calibration, Operator

SETTLED, NOTHING_HELPS, TIME_IS_UP, BROKEN_OFF = 'settled', 'nothing helps', 'time is up', 'broken off'
"""So long a cell tries to settle what is open, unless told otherwise [s]."""
MEANWHILE_S = 0.1


@dataclass(frozen=True)
class Round:
    """One further run: what was ``open`` before it (probabilities by name), the run, its bag."""

    open: Mapping[str, float]
    able: Able
    bag: Path

    def to_json_dict(self) -> dict[str, Any]:
        run = self.able.run
        return {'open': dict(self.open), 'setup': self.able.code, 'seconds': self.able.seconds, 'bag': str(self.bag),
                'wait_s': run.run.wait, 'watch_s': run.run.watch, 'again_after_s': run.run.again_after,
                'error_probability': run.error, 'between': list(run.between)}


@dataclass(frozen=True)
class Settled:
    """How it ended: ``how`` (``settled``, ``nothing helps``, ``time is up``, ``broken off``), the last diagnosis, what
    it leaves ``open``, the further runs; ``outcome`` of a run that did not end well; ``wanted``: the run for which no
    time is left."""

    how: str
    diagnosis: Diagnosis
    open: Mapping[str, float]
    rounds: tuple[Round, ...]
    outcome: Calibration | None = None
    wanted: Able | None = None

    @property
    def sure(self) -> bool:
        return self.how == SETTLED

    def to_json_dict(self) -> dict[str, Any]:
        return {'how': self.how, 'open': dict(self.open), 'rounds': [one.to_json_dict() for one in self.rounds],
                'seconds_wanted': self.wanted.seconds if self.wanted else None,
                'message': self.outcome.message if self.outcome else '', 'gap': self.diagnosis.to_json_dict()}


def settle(operator: Operator, bag: Path, effects: Sequence[Effect], *, time_s: float, steps: int = 0,
           repeats: int = 0, dwell_s: float = 0.0, say: Callable[[Round], None] = lambda _round: None,
           feedback: Callable[[Any], None] | None = None, meanwhile: Callable[[], object] = lambda: None) -> Settled:
    """Diagnose the closed ``bag``; make further runs, each mounted by code, until the answer is sure, no run that the
    cell can make helps, or the next would last beyond ``time_s``.

    ``steps``, ``repeats``, ``dwell_s``: as the bag was measured; ``say`` receives each round before it is made;
    ``feedback`` and ``meanwhile`` as :meth:`Operator.calibrate` takes them.  :class:`StepdiagError` where the log shows
    a mistake of commissioning.
    """
    end, codes = time.monotonic() + time_s, operator.setups_by_code()
    log, rounds = read_log(bag), []
    must_be_sane(log)
    while True:
        diagnosis = diagnose(log, effects)
        what = left_open(diagnosis)

        def ended(how: str, **more: Any) -> Settled:
            return Settled(how, diagnosis, what, tuple(rounds), **more)    # noqa: B023 - called in this turn alone
        if not what:
            return ended(SETTLED)
        made = [one.able.code for one in rounds if set(one.open) == set(what)]
        able = run_without_hands(diagnosis, effects, codes, made, end - time.monotonic())
        if able is None:
            late = run_without_hands(diagnosis, effects, codes, made)
            return ended(TIME_IS_UP, wanted=late) if late else ended(NOTHING_HELPS)
        rounds.append(Round(what, able, bag.with_name(f'{bag.name}_further_{len(rounds) + 1}')))
        say(rounds[-1])
        broken = _measured(operator, rounds[-1], steps, repeats, dwell_s, feedback, meanwhile)
        if broken is not None:
            return ended(BROKEN_OFF, outcome=broken)
        log = joined(log, read_log(rounds[-1].bag))


def _measured(operator: Operator, one: Round, steps: int, repeats: int, dwell_s: float,
              feedback: Callable[[Any], None] | None, meanwhile: Callable[[], object]) -> Calibration | None:
    """Make one further run into its bag; how it ended if not well."""
    run = one.able.run.run
    _wait(run.wait, meanwhile)
    operator.new_log(str(one.bag), steps)
    stand, = operator.parameters('step_sequencer', ['stand'])
    operator.set_parameters('step_sequencer', {'stand': max(run.watch, stand)})
    try:
        outcome = operator.calibrate([one.able.code], repeats, dwell_s, feedback, steps, meanwhile)
        if outcome.succeeded and run.again_after is not None:
            operator.set_parameters('step_sequencer', {'stand': stand})
            _wait(run.again_after, meanwhile)
            outcome = operator.calibrate([one.able.code], repeats, dwell_s, feedback, steps, meanwhile)
    finally:
        operator.set_parameters('step_sequencer', {'stand': stand})
        operator.bring('recorder', 'inactive')      # closes the bag
    return None if outcome.succeeded else outcome


def _wait(seconds: float, meanwhile: Callable[[], object]) -> None:
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0.0:
        meanwhile()
        time.sleep(min(left, MEANWHILE_S))
