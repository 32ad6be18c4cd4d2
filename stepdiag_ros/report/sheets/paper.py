"""A sheet on A4 pages for the PDF: results and picture first, then conditions and single targets."""

import io
import textwrap
from collections.abc import Iterator, Sequence
from functools import lru_cache

from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.image import imread
from matplotlib.textpath import text_to_path

from stepdiag_ros.report.plots import INK, SOFT
from stepdiag_ros.report.sheets.sheet import Grid, Sheet

A4 = (8.27, 11.69)
LEFT, RIGHT, TOP, BOTTOM = 0.75, 7.55, 11.1, 0.75
LINE, SIZE, TITLE = 0.165, 8.0, 15.0
"""Height of a line [inch], of a letter and of one of a title [pt]."""
COLUMN, VALUE_LETTERS = 2.55, 78
GAP, NARROW = 0.16, 0.9
"""Between two columns of a table, and how narrow [inch] a column of words may be made."""
PICTURE_DPI = 220


class _Paper:
    """Pages that fill from the top; a new one is begun where the next piece does not fit."""

    def __init__(self, heading: str):
        self.heading, self.pages = heading, []
        self.turn()

    def turn(self) -> None:
        self.page = Figure(figsize=A4)
        self.pages.append(self.page)
        self.y = TOP
        self.text(LEFT, TOP + 0.25, self.heading, size=7.5, color=SOFT)
        self.text(RIGHT, BOTTOM - 0.35, f'page {len(self.pages)}', size=7.5, color=SOFT, ha='right')

    def text(self, x: float, y: float, words: str, size: float = SIZE, **options) -> None:
        self.page.text(x / A4[0], y / A4[1], words, fontsize=size, va='top', **{'color': INK} | options)

    def need(self, height: float) -> None:
        if self.y - height < BOTTOM:
            self.turn()

    def lines(self, words: str, letters: int = 112, **options) -> None:
        for line in textwrap.wrap(words, letters) or ['']:
            self.need(LINE)
            self.text(LEFT, self.y, line, **options)
            self.y -= LINE

    def head(self, words: str) -> None:
        self.need(4 * LINE)
        self.y -= 0.6 * LINE
        self.text(LEFT, self.y, words, size=10.0, weight='bold')
        self.y -= 1.5 * LINE

    def grid(self, grid: Grid) -> None:
        """A table; columns as wide as their longest cell, or as the page allows."""
        self.head(grid.title)
        rows = [[h.lstrip('>') for h in grid.head],
                *([cell.replace(' ± ', ' ±\N{NO-BREAK SPACE}') for cell in row] for row in grid.rows)]
        right = [h.startswith('>') for h in grid.head]
        widths, size = _fitted(rows, right)
        starts = [LEFT + sum(widths[:i]) + GAP * i for i in range(len(widths))]
        for number, row in enumerate(rows):
            cells = [_wrapped(cell, width, size) for cell, width in zip(row, widths, strict=True)]
            deep = max(map(len, cells))
            self.need(LINE * deep)
            for cell, start, width, to_right in zip(cells, starts, widths, right, strict=True):
                for i, line in enumerate(cell):
                    self.text(start + (width if to_right else 0.0), self.y - i * LINE, line, size=size,
                              ha='right' if to_right else 'left', color=INK if number else SOFT)
            self.y -= LINE * (deep if number else deep + 0.25)
        if grid.note:
            self.lines(grid.note, color=SOFT)

    def picture(self, figure: Figure) -> None:
        """A figure over the page's width."""
        width, height = figure.get_size_inches()
        high = (RIGHT - LEFT) * height / width
        self.need(high)
        buffer = io.BytesIO()
        figure.savefig(buffer, format='png', dpi=PICTURE_DPI)
        buffer.seek(0)
        ax = self.page.add_axes((LEFT / A4[0], (self.y - high) / A4[1], (RIGHT - LEFT) / A4[0], high / A4[1]))
        ax.imshow(imread(buffer), aspect='auto', interpolation='none')
        ax.set_axis_off()
        self.y -= high + LINE


def pages_of(sheet: Sheet, source: str) -> Iterator[Figure]:
    """A4 pages of one sheet."""
    paper = _Paper(f'{sheet.standard} · {sheet.title} · log {source}')
    for line in _wrapped(f'{sheet.title}, {sheet.standard}', RIGHT - LEFT, TITLE, 'bold'):
        paper.text(LEFT, paper.y, line, size=TITLE, weight='bold')
        paper.y -= 1.6 * LINE
    paper.y -= 0.8 * LINE
    if sheet.shortfalls:
        paper.lines(f'Less than {sheet.standard} wants:', weight='bold', color='#b97a12')
        for sentence in sheet.shortfalls:
            paper.lines(f'– {sentence}', color='#7d5410')
    paper.grid(sheet.results)
    paper.y -= LINE
    paper.picture(sheet.draw())
    paper.lines(sheet.caption, color=SOFT)
    for note in sheet.notes:
        paper.lines(note)
    paper.head('Conditions of the test')
    for what, value in sheet.conditions:
        left, right = textwrap.wrap(what, 42), textwrap.wrap(value, VALUE_LETTERS)
        paper.need(LINE * max(len(left), len(right)))
        for i, line in enumerate(left):
            paper.text(LEFT, paper.y - i * LINE, line, color=SOFT)
        for i, line in enumerate(right):
            paper.text(LEFT + COLUMN, paper.y - i * LINE, line)
        paper.y -= LINE * max(len(left), len(right)) + 0.02
    for grid in sheet.details:
        paper.grid(grid)
    yield from paper.pages


@lru_cache(maxsize=4096)
def _width(words: str, size: float, weight: str = 'normal') -> float:
    """Width [inch] of words on the page."""
    return text_to_path.get_text_width_height_descent(words, FontProperties(size=size, weight=weight), False)[0] / 72.0


def _wrapped(words: str, width: float, size: float, weight: str = 'normal') -> list[str]:
    """The words in lines no wider than ``width`` [inch], but for single words that are."""
    lines = ['']
    for word in words.split(' '):
        longer = f'{lines[-1]} {word}' if lines[-1] else word
        if lines[-1] and _width(longer, size, weight) > width + 1e-9:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _fitted(rows: Sequence[Sequence[str]], right: Sequence[bool]) -> tuple[list[float], float]:
    """Widths [inch] of a table's columns and the size of its letters: cells are put into several lines first, then all
    letters are made smaller."""
    page, columns = RIGHT - LEFT - GAP * (len(right) - 1), list(zip(*rows, strict=True))
    whole = [max(_width(cell, SIZE) for cell in column) for column in columns]
    words = [max(_width(word, SIZE) for cell in column for word in cell.split(' ')) for column in columns]
    least = [min(width, max(word, 0.0 if figures else NARROW))
             for width, word, figures in zip(whole, words, right, strict=True)]
    if sum(least) > page:
        share = page / sum(least)
        return [share * w for w in least], share * SIZE
    spare, wanted = page - sum(least), sum(whole) - sum(least)
    share = min(1.0, spare / wanted) if wanted > 0.0 else 0.0
    return [low + share * (high - low) for low, high in zip(least, whole, strict=True)], SIZE
