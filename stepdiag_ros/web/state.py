"""What goes to the browser: plain values of what an observer knows, and nothing twice."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from stepdiag_msgs.msg import GapReport, GeometricErrors, Step
from stepdiag_ros.model.frames import View
from stepdiag_ros.nodes.observer import Observer, Seen
from stepdiag_ros.nodes.stamps import ns_of

DOING = {Step.MOVE: 'moves to', Step.DWELL: 'measures at', Step.DONE: 'has measured'}


class Story:
    """What one browser is told: the hall each time, of the machine that it looks at what is new."""

    def __init__(self, observer: Observer, machine: str):
        self._observer, self._name = observer, '/' + machine.strip('/')
        self._setup = ''
        self._number = 0
        self._errors: GeometricErrors | None = None
        self._gap_ns = -1

    def next(self, reports: list[dict[str, Any]]) -> dict[str, Any]:
        """The next message; ``reports``: what was finished."""
        hall = self._observer.overview()
        told: dict[str, Any] = {'hall': asdict(hall), 'reports': reports}
        if self._name == '/':
            return told
        seen = self._observer.machine(self._name)
        if seen is None or all(machine.name != self._name for machine in hall.machines):
            there = ', '.join(machine.name for machine in hall.machines)
            told['trouble'] = f'no machine {self._name} runs; ' + (f'choose one of {there}' if there else 'none does')
        if seen is not None:
            with self._observer.lock:
                told['machine'] = self._of(seen)
        return told

    def _of(self, seen: Seen) -> dict[str, Any]:
        told: dict[str, Any] = {'name': seen.namespace, 'recording': Path(seen.recording).name, 'trouble': seen.trouble,
                                'lengths': [row for row in seen.lengths if row[0] > self._number],
                                'spots': [row for row in seen.spots if row[0] > self._number]}
        self._number = seen.count
        step, description = seen.step, seen.description
        setup = step.setup if step is not None else next(iter(description.setups), '') if description else ''
        if description is not None and setup in description.setups:
            view = View(description, setup)
            if setup != self._setup:
                self._setup, told['scene'] = setup, scene_of(view, description.machine.name)
            if step is not None:
                position = [step.commanded.x, step.commanded.y, step.commanded.z]
                told['now'] = {'run': step.run_id, 'setup': step.setup, 'stop': step.index, 'stops': len(view.path),
                               'phase': int(step.phase), 'doing': DOING.get(step.phase, ''),
                               'point': view.tool + position, 'position': position}
        if seen.errors is not None and seen.errors is not self._errors:
            self._errors = seen.errors
            told['errors'] = errors_of(seen.errors)
        if seen.gap is not None and ns_of(seen.gap.header.stamp) != self._gap_ns:
            self._gap_ns = ns_of(seen.gap.header.stamp)
            told['gap'] = gap_of(seen.gap)
        return told


def scene_of(view: View, machine: str) -> dict[str, Any]:
    """One setup, as it is drawn; lengths in m."""
    return {'machine': machine, 'setup': view.setup, 'corner': view.corner, 'volume': view.volume, 'path': view.path,
            'triad': view.triad, 'origin': view.origin, 'starts': view.starts, 'psd_start': view.psd_start,
            'mirror_centre': view.mirror_centre, 'mirror_half': view.mirror_half}


def errors_of(message: GeometricErrors) -> dict[str, Any]:
    """The 21 errors; m and rad, one standard uncertainty."""
    return {'complete': message.complete, 'status': message.status, 'reduced_chi2': message.reduced_chi2,
            'dof': message.dof, 'squareness': list(message.squareness),
            'squareness_sigma': list(message.squareness_sigma),
            'curves': [{'name': curve.name, 'unit': curve.unit, 'position': list(curve.position),
                        'value': list(curve.value), 'sigma': list(curve.sigma)} for curve in message.curves],
            'unidentifiable': list(message.unidentifiable), 'warnings': list(message.warnings),
            'reference_temperature': message.reference_temperature, 'traceable': message.traceable,
            'time': 1e-9 * ns_of(message.header.stamp)}


def gap_of(message: GapReport) -> dict[str, Any]:
    """The diagnosis in short."""
    return {'verdict': message.verdict, 'channel': message.channel, 'before': message.before, 'after': message.after,
            'noise_floor': message.noise_floor, 'next_measurement': message.next_measurement,
            'effects': [{'name': one.name, 'probability': one.probability, 'closes': one.closes}
                        for one in message.effects]}
