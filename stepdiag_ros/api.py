"""What a program or a notebook needs of this package: a dozen names, all of them importable from ``stepdiag_ros``.

They need neither ROS nor a running cell.  Lengths are in metres, angles in radians, times in seconds or integer
nanoseconds; errors carry the names of ISO 230-1.  Bad input raises :class:`StepdiagError` with one line that says
what is wrong.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from stepdiag_ros.bag.export import write_log
from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.bag.recover import recover
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.evaluate import evaluate
from stepdiag_ros.estimate.methods import run_all
from stepdiag_ros.estimate.prediction import Prediction
from stepdiag_ros.estimate.prediction import predict as _predict
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.path import SetupPath, stops
from stepdiag_ros.virtual.cell import Cell, load_cell

__all__ = ['CalibrationLog', 'Cell', 'Description', 'Diagnosis', 'Solution', 'StepdiagError', 'compare', 'diagnose',
           'evaluate', 'load_cell', 'plan', 'predict', 'read_log', 'recover', 'simulate', 'to_json', 'write_log']


def simulate(cell: Cell | str | Path, setups: Iterable[str] | None = None,
             rate_hz: float | None = None) -> CalibrationLog:
    """The log of a whole calibration of a virtual cell, on a clock of its own.

    ``cell``: as :func:`load_cell` gives it, or its file.  ``setups``: only these, in this order; ``rate_hz``: of both
    sensors.  The same cell gives the same log.
    """
    from stepdiag_ros.virtual.offline import simulate_log
    described = cell if isinstance(cell, Cell) else load_cell(cell)
    return simulate_log(described, setups=None if setups is None else tuple(setups), rate=rate_hz)


def plan(description: Description) -> Mapping[str, SetupPath]:
    """The stops of every setup: ``positions`` (n, 3) [m] in the machine frame, and the axis ``moved`` to each (n,)."""
    return {name: stops(description, name) for name in description.setups}


def predict(solution: Solution, description: Description, points_m: np.ndarray,
            tool_m: np.ndarray | None = None) -> Prediction:
    """The volumetric error at ``points_m`` (n, 3) [m]: ``deviation_m`` (n, 3) and ``sigma_m`` (n, 3).

    ``tool_m`` (3,) [m]: another tool than the description's.
    """
    return _predict(solution, description.machine, np.asarray(points_m, float), tool_m)


def compare(log: CalibrationLog) -> tuple[Mapping[str, object], Mapping[str, str]]:
    """The result of every method of the literature that fits the log, by name; and why the others do not fit."""
    return run_all(log)


def diagnose(log: CalibrationLog, effect_files: Iterable[str | Path] = ()) -> Diagnosis:
    """Where log and rigid-body model disagree, which effect explains it, and how far the gap closes.

    ``effect_files``: Python files with effects of your own.  They are run: name only files that you trust.
    :class:`StepdiagError` where the log shows a mistake of commissioning.
    """
    from stepdiag_ros.effects import all_effects
    from stepdiag_ros.estimate.sanity_fit import must_be_sane
    from stepdiag_ros.gap.diagnose import diagnose as find
    must_be_sane(log)
    return find(log, [kind() for kind in all_effects([str(path) for path in effect_files]).values()])
