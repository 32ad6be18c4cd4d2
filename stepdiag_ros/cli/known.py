"""The machine's errors before anything acts on them: evaluation of a log, causes taken out, reversal.

What the diagnosis finds is taken off the readings, and these are evaluated as those of every log: in metres, at 20 °C,
with the whole budget.  The diagnosis itself looks at readings as recorded, so its own errors are neither.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from stepdiag_ros.estimate.metres import in_metres
from stepdiag_ros.estimate.reduce import StopTable, stops_of
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.traceability import CELL, TOPICS
from stepdiag_ros.model.log import CalibrationLog

if TYPE_CHECKING:
    from stepdiag_ros.gap.diagnosis import Diagnosis
    from stepdiag_ros.gap.inference.joint import Active

K = 2.0


@dataclass(frozen=True)
class Known:
    """The errors, lost motion of each axis with its U [m] by letter, and what a reader must know, in words."""

    solution: Solution
    reversal: dict[str, tuple[float, float]]
    notes: tuple[str, ...]


def known_errors(log: CalibrationLog, bag: str) -> Known:
    """Evaluate and diagnose ``log``; what the diagnosis finds beside the errors is taken out of them.

    Lost motion would end up in the positioning errors with half its size: a run is zeroed where its first stop was
    reached from behind.
    """
    from stepdiag_ros.compensate.fit_to_act import not_metres
    from stepdiag_ros.effects import all_effects
    from stepdiag_ros.estimate import evaluate
    from stepdiag_ros.gap.diagnose import diagnose

    plain = evaluate(log)
    if not_metres(plain, log) or plain.sanity:
        return Known(plain, {}, ())     # nobody will act on this
    diagnosis = diagnose(log, [kind() for kind in all_effects([]).values()])
    reversal = {axis: (found.parameters[axis], K * found.sigma[axis]) for found in diagnosis.effects
                if found.name == 'backlash' for axis in 'XYZ' if axis in found.parameters}
    notes, solution = [], plain
    names = [found.name for found in diagnosis.effects]
    if names:
        solution = _without_causes(log, diagnosis)
        notes.append(f'the log shows {", ".join(names)}; it is taken out of the errors')
    if diagnosis.unmodelled or any(name != 'backlash' for name in names):
        what = ('something that no known cause explains' if diagnosis.unmodelled
                else 'more than the errors of the machine')
        notes.append(f'the log shows {what}: read `stepdiag gap {bag}` before you act on this')
    return Known(solution, reversal, tuple(notes))


def _without_causes(log: CalibrationLog, diagnosis: 'Diagnosis') -> Solution:
    """The evaluation of the readings less what the causes add; its covariance has what is uncertain of the causes."""
    from stepdiag_ros.estimate.evaluate import evaluate_in_full, solution_of

    joint, stops = diagnosis.joint, stops_of(log)
    metres = in_metres(log, stops)
    done = {'air': metres.air in (TOPICS, CELL), 'scales': any(metres.conditions.referred)}
    added = _on_stops([active for active in joint.active if not done.get(active.effect.corrected)],
                      joint.observation.table, stops)
    solution = evaluate_in_full(log, stops=replace(stops, displacement=stops.displacement - added[:, :-2],
                                                   spot=stops.spot - added[:, -2:])).solution
    alone = solution_of(joint.fit, joint.observation.table)
    # What the mean over a cause's forms differs from its likeliest one, and what causes and forms add to variance.
    more = diagnosis.solution.covariance - alone.covariance
    values, vectors = np.linalg.eigh(0.5 * (more + more.T))
    more = (vectors * np.maximum(values, 0.0)) @ vectors.T
    repeats = solution.covariance if solution.repeatability is None else solution.repeatability
    return replace(solution, value=solution.value + diagnosis.solution.value - alone.value,
                   covariance=solution.covariance + more, repeatability=repeats + more)


def _on_stops(active: Iterable['Active'], pieces: StopTable, stops: StopTable) -> np.ndarray:
    """What causes add to the readings (n, c) [m] of ``stops``, where the diagnosis cut long dwells into ``pieces``."""
    channels = stops.displacement.shape[1] + 2
    added = sum((one.contribution for one in active), np.zeros((len(pieces), channels)))
    order = np.argsort(stops.dwell_ns, kind='stable')
    middle = (pieces.dwell_ns + pieces.done_ns) // 2
    of = order[np.searchsorted(stops.dwell_ns[order], middle, side='right') - 1]
    count = np.bincount(of, minlength=len(stops))
    return np.stack([np.bincount(of, weights=column, minlength=len(stops)) for column in added.T], axis=1) \
        / np.maximum(count, 1)[:, None]
