"""The truth of a virtual cell, for comparison with what a calibration finds."""

from typing import Any

from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS
from stepdiag_ros.model.path import plan_positions
from stepdiag_ros.virtual.cell import Cell


def truth(cell: Cell) -> dict[str, Any]:
    """Curves at the plan's positions, squareness, misalignments, effects: plain lists and floats.

    ``errors`` has the form that ``stepdiag evaluate --json`` gives, without ``sigma``.
    """
    description = cell.description
    errors: dict[str, Any] = {}
    for name in CURVES:
        position = plan_positions(description, AXES.index(name[2]))
        curve = cell.geometry.curves.get(name)
        value = curve(position) if curve is not None else 0.0 * position
        errors[name] = {'position_m': position.tolist(), 'value': value.tolist()}
    for name in SQUARENESS:
        errors[name] = {'value': float(cell.geometry.square.get(name, 0.0))}
    return {'cell': cell.source, 'machine': description.machine.name, 'seed': cell.seed,
            'errors': errors,
            'misalignments': {name: {'laser_rad': list(m.laser), 'mirror_rad': list(m.mirror),
                                     'psd_zero_m': list(cell.psd_zero[name])}
                              for name, m in cell.misalignments.items() if not description.setups[name].follows},
            **_stations(cell),
            'effects': {name: dict(parameters) for name, parameters in cell.effects.items()}}


def _stations(cell: Cell) -> dict[str, Any]:
    """Where the stations stand, where there are any."""
    found = {name: {'position_m': [s + d for s, d in zip(setup.station, cell.misalignments[name].station, strict=True)]}
             for name, setup in cell.description.setups.items() if setup.station is not None}
    return {'stations': found} if found else {}
