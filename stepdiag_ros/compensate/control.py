"""What a control's tables are to the rest: what they carry, and how their files are written and read.

A format is one module with one :class:`Control`.  ``read`` applies a file as its control does and is what every
prediction is made from, so that rounding, limited rows and even steps are in it.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.compensate.taken import Taken, Trim
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.machine import AXES, CURVES

MILLI = 1e3
NUMBER = '{:.6f}'
MOST_READ = 10_000
"""Rows that a table may have: more than any control takes."""
OWN = tuple(f'E{a}{a}' for a in AXES)
TRANSLATIONS = tuple(name for name in CURVES if name[1] in AXES)


@dataclass(frozen=True)
class Place:
    """Whose tables, and where: the machine, and machine coordinates ``origin`` (3,) [m] of its volume's corner."""

    machine: Machine
    origin: np.ndarray

    def of_tool(self, tool: np.ndarray) -> 'Place':
        """The same for another tool vector (3,) [m]."""
        x, y, z = (float(v) for v in tool)
        return replace(self, machine=replace(self.machine, tool=(x, y, z)))


@dataclass(frozen=True)
class Control:
    """A format of tables.

    ``carries``: error motions that it can take off.  ``write(taken, place)`` gives files by name, ``read(files,
    place)`` what a control takes off that holds them (:class:`StepdiagError` names file and line).  ``source``: what
    its signs and units follow; ``open_question`` what no manual that we know of confirms, or ''.  ``most_rows`` of a
    table; ``reverses``: whether a table can tell the directions of approach apart; ``joined``: error motions that
    share one file, so that loading it replaces them all.  ``straight``: error motions that it takes off as straight
    lines only, from one end of the volume to the other.  ``clear(files, there, every)``, where loading files takes
    nothing away: zeros for what ``there`` assigns and ``files`` does not, as files beside these; of tables that share a
    file, or of ``every`` one.  ``load``: how the tables are put in force, ``undo``: how they are taken back.
    """

    name: str
    title: str
    carries: tuple[str, ...]
    write: Callable[[Taken, Place], dict[str, str]]
    read: Callable[[Mapping[str, str], Place], dict[str, Trim]]
    source: str
    open_question: str
    load: str
    undo: str
    most_rows: int = MOST_READ
    reverses: bool = True
    joined: tuple[str, ...] = ()
    straight: tuple[str, ...] = ()
    clear: Callable[[Mapping[str, str], Mapping[str, str], bool], dict[str, str]] | None = None

    @property
    def whole_model(self) -> bool:
        """Whether the control computes the rotations over their levers itself."""
        return any(name[1] not in AXES for name in self.carries)


def number(value: float) -> str:
    """A value with nanometres as its last digit, never ``-0``."""
    text = NUMBER.format(value)
    return NUMBER.format(0.0) if float(text) == 0.0 else text


def numbers(text: str, count: int, where: str) -> list[float]:
    """``count`` finite numbers of a line."""
    parts = text.replace(',', ' ').split()
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) != count or not np.all(np.isfinite(values)):
        raise StepdiagError(f'{where}: {text.strip()!r} is not a row of {count} numbers; give the table as the '
                            'control holds it')
    return values


def trim_of(position: np.ndarray, forward: np.ndarray, reverse: np.ndarray, where: str) -> Trim:
    """A checked curve from a file: positions must rise."""
    if not 0 < len(position) <= MOST_READ:
        raise StepdiagError(f'{where}: holds {len(position)} rows; a table has 1 to {MOST_READ}')
    if np.any(np.diff(position) <= 0.0):
        raise StepdiagError(f'{where}: the positions do not rise; give the table as the control holds it')
    return Trim(np.asarray(position, float), np.asarray(forward, float), np.asarray(reverse, float))


def even(position: np.ndarray, most: int) -> np.ndarray:
    """An even grid over the positions that holds them all where there is one, of at most ``most`` rows."""
    if len(position) < 2:
        return position
    length = position[-1] - position[0]
    for count in range(len(position) - 1, min(most, 50 * len(position))):
        grid = position[0] + length * np.arange(count + 1) / count
        if np.max(np.min(np.abs(position[:, None] - grid), axis=1)) < 1e-7:
            return grid
    return np.linspace(position[0], position[-1], min(most, 4 * len(position)))


def thinned(trim: Trim, most: int) -> Trim:
    """The curve on at most ``most`` of its positions; those are dropped that a straight line replaces best."""
    position, forward, reverse = trim.position, trim.forward, trim.reverse
    while len(position) > most:
        left, right = position[:-2], position[2:]
        share = (position[1:-1] - left) / (right - left)
        off = np.maximum(*(np.abs(v[:-2] + share * (v[2:] - v[:-2]) - v[1:-1]) for v in (forward, reverse)))
        drop = 1 + int(np.argmin(off))
        position, forward, reverse = (np.delete(v, drop) for v in (position, forward, reverse))
    return Trim(position, forward, reverse)


def axis_of(name: str, where: str) -> int:
    """Number of the axis that a control calls ``name`` (``X``, ``X1``, ``AX1``)."""
    match = re.fullmatch(r'([XYZ])\d?|AX([123])', name.strip().upper())
    if not match:
        raise StepdiagError(f'{where}: {name.strip()!r} is no axis that is known; name X, Y, Z, X1 … or AX1 …')
    return AXES.index(match[1]) if match[1] else int(match[2]) - 1
