"""The effects of a cell, made from its file, and the random numbers that they may draw."""

from pathlib import Path

import numpy as np

from stepdiag_ros.effects import effect_class, effects_in_file
from stepdiag_ros.effects.base import Effect
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.draw import normals, uniforms


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
    file of the user's own (relative to the cell's) that holds it.
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
            kind = next((k for k in effects_in_file(str(path)) if k.name == name), None)
    except StepdiagError as error:
        raise StepdiagError(f'{where}: {error}') from None
    if kind is None:
        raise StepdiagError(f'{where}: {path} holds no effect named {name!r}; call it in the cell as it '
                            'calls itself')
    try:
        return kind(**values)
    except (ValueError, TypeError) as error:
        raise StepdiagError(f'{where}: {error}') from None
