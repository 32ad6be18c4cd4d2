"""The effects of a cell, made from its file, and the random numbers that they may draw."""

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from stepdiag_ros.effects import effect_class, effects_in_file
from stepdiag_ros.effects.base import Effect, Parameter
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.guard.files import real
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.draw import normals, uniforms

#: Effect files that the user has named on the command line; the processes of the cell inherit it.
ALLOWED = 'STEPDIAG_EFFECT_FILES'


def allow_effect_files(paths: Iterable[str | Path]) -> None:
    """Let cell files name these Python files, which are then run."""
    known = os.environ.get(ALLOWED, '').split(os.pathsep)
    os.environ[ALLOWED] = os.pathsep.join(filter(None, [*known, *(str(real(path)) for path in paths)]))


class Draws:
    """Random numbers of one cell and effect, addressed by name and index."""

    def __init__(self, seed: int, effect: str):
        self._seed, self._effect = seed, effect

    def normals(self, name: str, first: int, count: int, columns: int = 1) -> np.ndarray:
        """(count, columns) standard normal numbers for the indices from ``first`` on."""
        return normals(self._seed, f'effect/{self._effect}/{name}', first, count, columns)

    def uniforms(self, name: str, first: int, count: int, columns: int = 1) -> np.ndarray:
        """(count, columns) numbers in (0, 1) for the indices from ``first`` on."""
        return uniforms(self._seed, f'effect/{self._effect}/{name}', first, count, columns)


def create_effects(cell: Cell) -> list[Effect]:
    """The effects that a cell names, in its order.

    An effect is found by its name in ``stepdiag_ros.effects``; a parameter ``file`` names a Python
    file of the user's own (relative to the cell's) that holds it.  That file is run, so it must have been
    named by :func:`allow_effect_files` before: a cell file from a stranger runs nothing.
    """
    return [_create(cell, name, dict(values)) for name, values in cell.effects.items()]


def _create(cell: Cell, name: str, values: dict) -> Effect:
    file = values.pop('file', None)
    where = f'{cell.source}: effects.{name}'
    try:
        if file is None:
            kind = effect_class(name)
        else:
            path = Path(cell.source).parent / str(file)
            if str(real(path)) not in os.environ.get(ALLOWED, '').split(os.pathsep):
                raise StepdiagError(f'names the Python file {path}, which would be run; if you trust it, give '
                                    f'--effect {path}')
            kind = next((k for k in effects_in_file(str(path)) if k.name == name), None)
    except StepdiagError as error:
        raise StepdiagError(f'{where}: {error}') from None
    if kind is None:
        raise StepdiagError(f'{where}: {path} holds no effect named {name!r}; call it in the cell as it '
                            'calls itself')
    try:
        effect = kind(**values)
    except (ValueError, TypeError) as error:
        raise StepdiagError(f'{where}: {error}') from None
    for parameter in effect.parameters:
        _check_size(where, parameter, getattr(effect, parameter.name))
    if effect.course is not None:
        for parameter, column in zip(effect.amounts(), effect.course.values.T, strict=True):
            _check_size(f'{where}: course', parameter, column)
    return effect


def _check_size(where: str, parameter: Parameter, value: np.ndarray | float) -> None:
    """Raises where a value is no size that such an effect could have: light and machine would be nowhere."""
    most = limits.EFFECT_TIMES * max(abs(parameter.low), abs(parameter.high)) or 1.0
    # What is never zero, like a radius or a time constant; times and frequencies are not negative either.
    least = max(parameter.low, 0.0) / limits.EFFECT_TIMES
    signed = not (least and parameter.unit in ('s', 'Hz'))
    for part in np.atleast_1d(value).tolist():
        if not least <= (abs(part) if signed else part) <= most:
            either = ', of either sign' if signed else ''
            raise StepdiagError(f'{where}: {parameter.name} is {part:g}; give {least:g} to {most:g} '
                                f'{parameter.unit}{either}')
