"""A test sheet as data: what HTML and PDF both show."""

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure


@dataclass(frozen=True)
class Grid:
    """A table of text: its title, the column heads, the rows, and the note below it."""

    title: str
    head: tuple[str, ...]
    rows: list[tuple[str, ...]]
    note: str = ''


@dataclass(frozen=True)
class Sheet:
    """One sheet: ``title``, the ``standard``, ``results``, ``conditions`` (what, value), ``shortfalls`` (sentences),
    ``draw`` the picture with its ``caption``, ``details`` (tables of single targets), ``notes`` (sentences), ``enough``
    (what is said where nothing falls short)."""

    title: str
    standard: str
    results: Grid
    conditions: list[tuple[str, str]]
    shortfalls: list[str]
    draw: Callable[[], Figure]
    caption: str
    details: list[Grid]
    notes: list[str]
    enough: str = 'Targets and cycles are as many as the standard wants.'


def micro(value: float | None, digits: int = 3) -> str:
    """A length [m] in µm without the unit; a dash where there is none."""
    return '–' if value is None else f'{1e6 * value:.{digits}f}'.replace('-', '−')
