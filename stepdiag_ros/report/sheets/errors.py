"""The errors of the machine on a sheet: what the joint estimate of a log found, and what it leaves open."""

import numpy as np

from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS
from stepdiag_ros.report.sheets.sheet import Grid, micro


def still_open(solution: Solution) -> list[str]:
    """Names of the errors that a log leaves open."""
    return list(dict.fromkeys(member.split()[0] for entry in solution.unidentifiable for member in entry.names
                              if member.split()[0] in (*CURVES, *SQUARENESS)))


def errors_grid(solution: Solution) -> Grid:
    """Every error that is not open: by how much its curve rises and falls, or its value, and U."""
    left, rows = still_open(solution), []
    for name in (*CURVES, *SQUARENESS):
        if name in left or not solution.has(name):
            continue
        value, sigma = (solution.squareness(name) if name in SQUARENESS else solution.curve(name)[1:])
        unit = 'µm' if name not in SQUARENESS and name[1] in AXES else 'µrad'
        rows.append((name, micro(float(np.ptp(value)) if np.ndim(value) else float(value)),
                     micro(2.0 * float(np.max(sigma))), unit))
    head = ('', '>from lowest to highest (squareness: value)', '>U at most (k = 2)', '')
    return Grid('Errors that are not open', head, rows)


def open_note(solution: Solution) -> list[str]:
    """A sentence where something stays open."""
    left = still_open(solution)
    return [f'Left open by the log: {", ".join(left)}.'] if left else []
