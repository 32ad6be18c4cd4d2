"""A sheet on A4 pages for the PDF: results and picture first, then conditions and single targets."""

import io
import textwrap
from collections.abc import Iterator

from matplotlib.figure import Figure
from matplotlib.image import imread

from stepdiag_ros.report.plots import INK, SOFT
from stepdiag_ros.report.sheets.sheet import Grid, Sheet

A4 = (8.27, 11.69)
LEFT, RIGHT, TOP, BOTTOM = 0.75, 7.55, 11.1, 0.75
LINE, SIZE = 0.165, 8.0
"""Height of a line [inch] and of a letter [pt]."""
COLUMN, VALUE_LETTERS = 2.55, 78
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
        """A table; columns as wide as their longest cell."""
        self.head(grid.title)
        columns = list(zip(*[[h.lstrip('>') for h in grid.head], *grid.rows], strict=True))
        widths = [max(len(cell) for cell in column) + 2 for column in columns]
        share = min((RIGHT - LEFT) / sum(widths), 0.085)
        starts = [LEFT + share * sum(widths[:i]) for i in range(len(widths))]
        for number, row in enumerate([[h.lstrip('>') for h in grid.head], *grid.rows]):
            self.need(LINE)
            for i, cell in enumerate(row):
                right = grid.head[i].startswith('>')
                self.text(starts[i] + (share * (widths[i] - 2) if right else 0.0), self.y, cell,
                          ha='right' if right else 'left', color=INK if number else SOFT)
            self.y -= LINE * (1.0 if number else 1.25)
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
    paper.text(LEFT, paper.y, f'{sheet.title}, {sheet.standard}', size=15.0, weight='bold')
    paper.y -= 2.4 * LINE
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
