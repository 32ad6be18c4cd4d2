"""Small multiples as SVG text: panels with ticks, bands, lines and points, written from whole arrays at once.

Positions are in pixels, y downwards; colours are names of the page's style (``before``, ``after`` …), so that a page
and its pictures change together.  Nothing is referred to by an id and nothing is fetched.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

DOT, RIGHT, LEFT = 'dot', 'right', 'left'
"""Shapes of points; the triangles point the way of the travel."""
TRIANGLES = {RIGHT: 'l-3.6-1.9v3.8z', LEFT: 'l3.6-1.9v3.8z'}
TICK_ROOM, LABEL_ROOM = 13.0, 14.0
"""Height [px] below a panel for the numbers, and for the words under them."""


def span(*values: np.ndarray, room: float = 0.06, least: float = 0.0) -> tuple[float, float]:
    """The range of all finite values, a little wider, at least ``least`` wide."""
    known = np.concatenate([np.ravel(part)[np.isfinite(np.ravel(part))] for part in values])
    low, high = (float(known.min()), float(known.max())) if known.size else (-1.0, 1.0)
    wide = max(high - low, least, 1e-12 * max(abs(low), abs(high)), 1e-30)
    middle = 0.5 * (low + high)
    return middle - (0.5 + room) * wide, middle + (0.5 + room) * wide


def ticks(low: float, high: float, most: int) -> tuple[np.ndarray, list[str]]:
    """Round places (steps of 1, 2 or 5 times a power of ten) in a range, at most ``most``, and how they are written."""
    raw = (high - low) / max(most, 1)
    power = 10.0 ** np.floor(np.log10(raw))
    for step in (1.0, 2.0, 5.0, 10.0, 20.0):
        places = np.arange(np.ceil(low / (step * power) - 1e-9), np.floor(high / (step * power) + 1e-9) + 1.0)
        if len(places) <= max(most, 1):
            break
    places = places * step * power
    digits = max(0, -int(np.floor(np.log10(step * power) + 1e-9)))
    return places, [f'{place + 0.0:.{digits}f}'.replace('-', '−') if abs(place) > 1e-9 * step * power else '0'
                    for place in places]


@dataclass
class Panel:
    """A rectangle [px] of a picture with the ranges of what it shows; what leaves them is cut off."""

    left: float
    top: float
    width: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]
    drawn: list[str] = field(default_factory=list)
    beside: list[str] = field(default_factory=list)

    def across(self, values: np.ndarray) -> np.ndarray:
        """Where values of x lie [px from the panel's left]."""
        return (np.asarray(values, dtype=float) - self.x[0]) * (self.width / (self.x[1] - self.x[0]))

    def down(self, values: np.ndarray) -> np.ndarray:
        """Where values of y lie [px from the panel's top]."""
        return (self.y[1] - np.asarray(values, dtype=float)) * (self.height / (self.y[1] - self.y[0]))

    def points(self, x: np.ndarray, y: np.ndarray, colour: str, size: float = 2.4, shape: str = DOT) -> None:
        """A mark at each point that is known."""
        known = np.isfinite(x) & np.isfinite(y)
        across, down = self.across(np.asarray(x)[known]), self.down(np.asarray(y)[known])
        if shape == DOT:
            self._path(_written('M%.1f %.1fh0', across, down), colour,
                       f'fill="none" stroke="currentColor" stroke-linecap="round" stroke-width="{size}"')
        else:
            tip = across + (1.8 if shape == RIGHT else -1.8)
            self._path(_written(f'M%.1f %.1f{TRIANGLES[shape]}', tip, down), colour, 'fill="currentColor"')

    def line(self, x: np.ndarray, y: np.ndarray, colour: str, width: float = 1.2,
             part: np.ndarray | None = None) -> None:
        """Lines through the points that are known; one for each run of equal values in ``part``."""
        known = np.isfinite(x) & np.isfinite(y)
        across, down = self.across(np.asarray(x)[known]), self.down(np.asarray(y)[known])
        if not len(across):
            return
        begins = np.ones(len(across), dtype=bool)
        begins[1:] = False if part is None else np.diff(np.asarray(part)[known]) != 0
        text = ''.join([f'{"M" if begin else "L"}{a:.1f} {d:.1f}'
                        for begin, a, d in zip(begins.tolist(), across.tolist(), down.tolist(), strict=True)])
        self._path(text, colour, f'fill="none" stroke="currentColor" stroke-linejoin="round" stroke-width="{width}"')

    def band(self, x: np.ndarray, low: np.ndarray, high: np.ndarray, colour: str, opacity: float = 1.0) -> None:
        """The area between two curves."""
        if len(x):
            across = self.across(np.concatenate([x, x[::-1]]))
            text = _written('L%.1f %.1f', across, self.down(np.concatenate([low, high[::-1]])))
            self._path(f'M{text[1:]}z', colour, f'fill="currentColor" fill-opacity="{opacity}"')

    def upright(self, x: float, colour: str = 'grid') -> None:
        """A line from top to bottom."""
        self._path(f'M{float(self.across(x)):.1f} 0v{self.height:.1f}', colour, 'stroke="currentColor"')

    def say(self, x: float, y: float, text: str, colour: str = 'soft', anchor: str = 'start',
            size: float = 10.0) -> None:
        """Text at a place [px from the panel's corner], which may lie outside."""
        self.beside.append(words(self.left + x, self.top + y, text, colour, anchor, size))

    def frame(self, title: str = '', x_label: str = '', y_label: str = '', numbers: str = 'xy', grid: str = 'xy',
              most: int = 0, counted: tuple[float, float] | None = None) -> None:
        """The axes in ``grid`` get rules, those in ``numbers`` what the rules stand for; title above, labels with their
        units beside.  ``most``: rules across; ``counted``: the part of x that has any."""
        rules = []
        for axis in grid:
            low, high = (counted or self.x) if axis == 'x' else self.y
            room = self.width / 46.0 if axis == 'x' else self.height / 24.0
            for place, text in zip(*ticks(low, high, most if axis == 'x' and most else max(2, int(room))), strict=True):
                if axis == 'x':
                    at = float(self.across(place))
                    rules.append(f'M{at:.1f} 0v{self.height:.1f}')
                    if 'x' in numbers:
                        self.say(at, self.height + TICK_ROOM - 1.5, text, anchor='middle')
                else:
                    at = float(self.down(place))
                    rules.append(f'M0 {at:.1f}h{self.width:.1f}')
                    if 'y' in numbers:
                        self.say(-5.0, at + 3.5, text, anchor='end')
        self.drawn.insert(0, f'<path class="grid" stroke="currentColor" d="{"".join(rules)}"/>')
        if title:
            self.say(0.0, -6.0, title, 'ink title', size=11.0)
        if x_label:
            self.say(self.width / 2.0, self.height + TICK_ROOM + LABEL_ROOM - 2.5, x_label, anchor='middle')
        if y_label:
            middle = self.top + self.height / 2.0
            self.beside.append(words(11.0, middle, y_label, 'soft', 'middle', 10.5,
                                     f' transform="rotate(-90 11 {middle:.1f})"'))

    def svg(self) -> str:
        """The panel and the words around it."""
        place = f'x="{self.left:.1f}" y="{self.top:.1f}" width="{self.width:.1f}" height="{self.height:.1f}"'
        return (f'<svg {place}>{"".join(self.drawn)}</svg>'
                f'<path class="axis" stroke="currentColor" fill="none" d="M{self.left:.1f} {self.top:.1f}'
                f'v{self.height:.1f}h{self.width:.1f}"/>{"".join(self.beside)}')

    def _path(self, path: str, colour: str, how: str) -> None:
        if path:
            self.drawn.append(f'<path class="{colour}" {how} d="{path}"/>')


def picture(panels: Iterable[Panel], width: float, height: float, label: str) -> str:
    """One drawing of several panels; ``label``: what it shows, for who does not see it."""
    return (f'<svg class="panels" viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(label)}">'
            f'{"".join(panel.svg() for panel in panels)}</svg>')


def wide(drawing: str, width: float) -> str:
    """A drawing in a box of its own, which scrolls sideways where the page is narrower than it can be read."""
    return f'<div class="scroll"><div style="min-width:{width:.0f}px">{drawing}</div></div>'


def side_by_side(drawings: Iterable[str], least: float) -> str:
    """Drawings in as many columns, each at least ``least`` px wide, as the page has room for."""
    return f'<div class="multiples" style="--least:{least:.0f}px">{"".join(drawings)}</div>'


def legend(entries: Sequence[tuple[str, str, str]]) -> str:
    """What marks mean: the kind (``band``, ``line`` or the shape of a point), its colour, the words."""
    marks = {'band': 'M1 2h20v8H1z" fill="currentColor', 'line': 'M1 6h20" stroke="currentColor" stroke-width="1.8',
             DOT: 'M11 6h0" stroke="currentColor" stroke-linecap="round" stroke-width="5',
             RIGHT: 'M14 6l-7-4v8z" fill="currentColor', LEFT: 'M8 6l7-4v8z" fill="currentColor'}
    return '<div class="legend">' + ''.join(
        f'<span><svg width="22" height="12" aria-hidden="true"><path class="{colour}" d="{marks[kind]}"/></svg>'
        f'{escape(said)}</span>' for kind, colour, said in entries) + '</div>'


def words(x: float, y: float, text: str, colour: str, anchor: str, size: float, more: str = '') -> str:
    """Text at a place [px]."""
    return (f'<text class="{colour}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="{size:g}"{more}>'
            f'{escape(text)}</text>')


def _written(each: str, *columns: np.ndarray) -> str:
    """``each`` once a row."""
    return (each * len(columns[0])) % tuple(np.stack(columns, axis=1).ravel().tolist())
