"""The effects of a cell, made from its file, and the random numbers that they may draw."""

import importlib
import importlib.util
from pathlib import Path

import numpy as np

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
    if file is not None:
        path = Path(cell.source).parent / str(file)
        spec = importlib.util.spec_from_file_location(f'stepdiag_effect_{path.stem}', path)
        if spec is None or not path.exists():
            raise StepdiagError(f'{where}.file: {path} does not exist or is no Python file; '
                                'give the path from the cell file')
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    else:
        try:
            module = importlib.import_module(f'stepdiag_ros.effects.{name}')
        except ModuleNotFoundError:
            raise StepdiagError(f'{where}: there is no effect of this name; names are the '
                                "contract's, e.g. backlash, or give `file:` for one of your own"
                                ) from None
    kind = next((value for value in vars(module).values()
                 if isinstance(value, type) and issubclass(value, Effect) and value.name == name),
                None)
    if kind is None:
        raise StepdiagError(f'{where}: {module.__name__} holds no effect named {name!r}')
    try:
        return kind(**values)
    except (ValueError, TypeError) as error:
        raise StepdiagError(f'{where}: {error}') from None
