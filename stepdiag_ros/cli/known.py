"""The machine's errors before anything acts on them: evaluation of a log, causes taken out, reversal."""

from dataclasses import dataclass, replace

from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.log import CalibrationLog

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
    from stepdiag_ros.compensate.metres import not_metres
    from stepdiag_ros.effects import all_effects
    from stepdiag_ros.estimate import evaluate
    from stepdiag_ros.gap.diagnose import diagnose

    plain = evaluate(log)
    if not_metres(plain, log):
        return Known(plain, {}, ())     # nobody will act on this
    diagnosis = diagnose(log, [kind() for kind in all_effects([]).values()])
    reversal = {axis: (found.parameters[axis], K * found.sigma[axis]) for found in diagnosis.effects
                if found.name == 'backlash' for axis in 'XYZ' if axis in found.parameters}
    notes, solution = [], plain
    names = [found.name for found in diagnosis.effects]
    if names:
        solution = _with_budget(diagnosis.solution, plain)
        notes.append(f'the log shows {", ".join(names)}; it is taken out of the errors')
    if diagnosis.unmodelled or any(name != 'backlash' for name in names):
        what = ('something that no known cause explains' if diagnosis.unmodelled
                else 'more than the errors of the machine')
        notes.append(f'the log shows {what}: read `stepdiag gap {bag}` before you act on this')
    return Known(solution, reversal, tuple(notes))


def _with_budget(found: Solution, plain: Solution) -> Solution:
    """The diagnosed errors with what the budget of the plain evaluation adds to its repeats."""
    if plain.repeatability is None or found.traceability is not None or found.names != plain.names:
        return found
    return replace(found, covariance=found.covariance + plain.covariance - plain.repeatability,
                   repeatability=found.covariance, traceability=plain.traceability)
