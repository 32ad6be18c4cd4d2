"""Sheets of a log as one HTML file with inline SVG and as one PDF."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

import matplotlib
from matplotlib.backends.backend_pdf import PdfPages

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.evaluate import Evaluation
from stepdiag_ros.estimate.method_budget import Readings
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.report.page import figure, page, table
from stepdiag_ros.report.plots import STYLE, svg
from stepdiag_ros.report.sheets.diagonals import diagonal_sheets
from stepdiag_ros.report.sheets.linear import linear_sheets
from stepdiag_ros.report.sheets.paper import pages_of
from stepdiag_ros.report.sheets.sheet import Grid, Sheet
from stepdiag_ros.report.sheets.stations import station_sheets
from stepdiag_ros.report.sheets.steps import step_sheets

HTML, PDF = 'sheets.html', 'sheets.pdf'


def sheets_of(log: CalibrationLog, evaluation: Evaluation, source: str) -> list[Sheet]:
    """Every sheet that a log holds enough for; :class:`StepdiagError` where it holds none."""
    readings = Readings.of(evaluation)
    cell = readings.measured
    found = [*linear_sheets(log, readings, source), *diagonal_sheets(log, readings, source),
             *step_sheets(log, evaluation, cell, source), *station_sheets(log, evaluation, source)]
    if not found:
        raise StepdiagError(f'{log.source}: no sheet can be made: ISO 230-2 needs a linear setup run forward and '
                            f'backward, ISO 230-6 a diagonal, multilateration a station{cell.why()}')
    return found


def write_sheets(sheets: Sequence[Sheet], source: str, folder: Path) -> tuple[Path, Path]:
    """Write :data:`HTML` and :data:`PDF` into ``folder``; returns their paths."""
    html, pdf = folder / HTML, folder / PDF
    try:
        html.write_text(html_of(sheets, source), encoding='utf-8')
        with matplotlib.rc_context(STYLE | {'axes.grid': True}), \
                PdfPages(pdf, metadata={'Title': f'{source}: test sheets', 'CreationDate': None}) as paper:
            for sheet in sheets:
                for one in pages_of(sheet, source):
                    paper.savefig(one)
    except OSError as error:
        raise StepdiagError(f'{folder}: the sheets cannot be written: {error.strerror or error}') from None
    return html, pdf


def html_of(sheets: Sequence[Sheet], source: str) -> str:
    """All sheets as one HTML document, each on a page of its own in print."""
    body = [f'<section class="sheet">{_section(sheet, source, number)}</section>'
            for number, sheet in enumerate(sheets, 1)]
    style = '<style>.sheet+.sheet{margin-top:60px}@media print{.sheet+.sheet{break-before:page}}</style>'
    return page(f'{source}: test sheets', style + '\n'.join(body))


def _section(sheet: Sheet, source: str, number: int) -> str:
    with matplotlib.rc_context(STYLE):
        drawing = svg(sheet.draw())
    short = ''.join(f'<li>{escape(sentence)}</li>' for sentence in sheet.shortfalls)
    said = (f'<div class="todo warn2"><b>Less than {sheet.standard} wants</b><ul>{short}</ul></div>' if short
            else f'<p class="soft">{sheet.enough}</p>')
    notes = ''.join(f'<p>{escape(note)}</p>' for note in sheet.notes)
    return (f'<header><div class="kicker">{escape(sheet.standard)} · log {escape(source)}</div>'
            f'<h1>{escape(sheet.title)}</h1></header>{said}{_grid(sheet.results)}'
            + figure(drawing, escape(sheet.caption), number) + notes + '<h2>Conditions of the test</h2>'
            + table(['', ''], [[escape(what), escape(value)] for what, value in sheet.conditions])
            + ''.join(f'<details open><summary>{escape(grid.title)}</summary>{_grid(grid, heading=False)}</details>'
                      for grid in sheet.details))


def _grid(grid: Grid, heading: bool = True) -> str:
    title = f'<h3>{escape(grid.title)}</h3>' if heading else ''
    head = [f'>{escape(h[1:])}' if h.startswith('>') else escape(h) for h in grid.head]
    note = f'<p class="soft">{escape(grid.note)}</p>' if grid.note else ''
    return title + table(head, [[escape(cell) for cell in row] for row in grid.rows]) + note
