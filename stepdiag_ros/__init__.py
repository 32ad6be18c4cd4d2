"""In-machine calibration of three-axis machine tools by the enhanced laser step diagonal method.

The names below are the interface for programs and notebooks (docs/tutorials/in_python.md); the rest may change.
"""

import os
from typing import TYPE_CHECKING, Any

# The matrices here are small: one thread is fastest, leaves the cell's other processes their
# cores, and makes results bit-identical whatever the machine.  Must precede NumPy's import.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

if TYPE_CHECKING:
    from stepdiag_ros.api import (
        CalibrationLog,
        Cell,
        Description,
        Diagnosis,
        Solution,
        StepdiagError,
        compare,
        diagnose,
        evaluate,
        load_cell,
        plan,
        predict,
        read_log,
        recover,
        simulate,
        to_json,
        write_log,
    )

__all__ = ['CalibrationLog', 'Cell', 'Description', 'Diagnosis', 'Solution', 'StepdiagError', 'compare', 'diagnose',
           'evaluate', 'load_cell', 'plan', 'predict', 'read_log', 'recover', 'simulate', 'to_json', 'write_log']


def __getattr__(name: str) -> Any:
    """A name of the interface, imported when it is first asked for: the commands start without it."""
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from stepdiag_ros import api
    return getattr(api, name)


def __dir__() -> list[str]:
    return [*__all__, *globals()]
