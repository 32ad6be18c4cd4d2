"""What the graph finds out, as messages: the errors, and the diagnosis of the gap."""

import math
from typing import TYPE_CHECKING

from std_msgs.msg import Header

from stepdiag_msgs.msg import ErrorCurve, GapEffect, GapPlace, GapReport, GeometricErrors
from stepdiag_ros.estimate import Solution
from stepdiag_ros.model.machine import CURVES, SQUARENESS
from stepdiag_ros.nodes.stamps import stamp_of

if TYPE_CHECKING:     # the solver answers too, and needs no diagnosis
    from stepdiag_ros.gap.diagnosis import Diagnosis


def errors_message(solution: Solution, last_step_ns: int, complete: bool = True) -> GeometricErrors:
    """A solution as a message, stamped with the last step of its log; ``complete``: of a calibration that has ended."""
    squareness = [solution.squareness(name) if solution.has(name) else (math.nan, math.nan) for name in SQUARENESS]
    tied = solution.traceability
    reference = None if tied is None else tied.reference_temperature
    return GeometricErrors(
        header=Header(stamp=stamp_of(last_step_ns)), complete=complete, status=solution.status,
        reduced_chi2=math.nan if solution.reduced_chi2 is None else float(solution.reduced_chi2),
        dof=int(solution.dof or 0), squareness=[value for value, _ in squareness],
        squareness_sigma=[sigma for _, sigma in squareness],
        curves=[_curve(solution, name) for name in CURVES if solution.has(name)],
        unidentifiable=[f'{", ".join(one.names)}: {one.why}' for one in solution.unidentifiable],
        warnings=[*map(str, solution.sanity), *solution.warnings],
        reference_temperature=math.nan if reference is None else float(reference), traceable=solution.traceable)


def _curve(solution: Solution, name: str) -> ErrorCurve:
    position, value, sigma = solution.curve(name)
    return ErrorCurve(name=name, unit='m' if name[1] in 'XYZ' else 'rad', position=_list(position), value=_list(value),
                      sigma=_list(sigma), sigma_repeatability=_list(solution.curve_repeatability(name)))


def report_message(diagnosis: 'Diagnosis', time_ns: int) -> GapReport:
    """A diagnosis as a message."""
    gap = diagnosis.cross_validation
    return GapReport(
        header=Header(stamp=stamp_of(time_ns)), verdict=diagnosis.verdict, channel=gap.channel,
        before=float(gap.before_m), after=float(gap.after_m), noise_floor=float(gap.floor_m),
        places=[GapPlace(channel=share.channel, setup=share.setup or '', axis=share.axis or '',
                         direction=int(share.direction or 0), share=float(share.share)) for share in diagnosis.shares],
        effects=[GapEffect(name=found.name, probability=float(found.probability), parameters=list(found.parameters),
                           value=_list(found.parameters.values()),
                           sigma=[float(found.sigma.get(name, math.nan)) for name in found.parameters],
                           unit=found.units, closes=float(found.closes)) for found in diagnosis.effects],
        indistinguishable=[' '.join(group) for group in diagnosis.indistinguishable],
        next_measurement=diagnosis.next_measurement or '', warnings=list(diagnosis.warnings))


def _list(values) -> list[float]:
    return [float(value) for value in values]
