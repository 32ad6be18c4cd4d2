"""The page of a verification: the decision, the figures before and after, where in the volume, the prediction."""

from html import escape

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.compensate.verified import CONFORMS, FAILS, UNDECIDED, VOLUMETRIC, Agreement, Verified
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.report.compensation_figure import draw_planes
from stepdiag_ros.report.figures import draw_calibration
from stepdiag_ros.report.page import figure, page, table
from stepdiag_ros.report.plots import STYLE, svg

BADGE = {CONFORMS: 'good', UNDECIDED: 'warn', FAILS: 'bad'}
NAMES = {VOLUMETRIC: 'volumetric error', 'E': 'E, body diagonals (ISO 230-6)', 'B': 'B, body diagonals (ISO 230-6)'}
UNITS = {'m': 'µm', 'rad': 'µrad'}


def number(value: float | None) -> str:
    """Millionths with two digits, a dash for what is not known."""
    return '–' if value is None else f'{1e6 * value:.2f}'


def agreement_words(agreement: Agreement) -> str:
    """Whether the measurement is as predicted, in a sentence."""
    text = (f'largest deviation {1e6 * agreement.volumetric:+.2f} µm from the predicted one '
            f'(U = {1e6 * agreement.spread:.2f} µm, 95 %)')
    if agreement.agrees:
        return f'as predicted: {text}'
    off = ', '.join(f'{name} ({score:.1f} combined standard uncertainties)' for name, score in agreement.off.items())
    return f'NOT as predicted: {text}' + (f'; off are {off}' if off else '') + \
        '; check sign, units and origin of the tables before anything else'


def verify_page(found: Verified, before: Solution, after: Solution, names: tuple[str, str], notes: tuple[str, ...]
                ) -> str:
    """The HTML; ``names`` of the logs before and after."""
    worst = next(f for f in found.figures if f.name == VOLUMETRIC)
    head = (f'<header><div class="kicker">Machine {escape(found.machine.name)} · before: {escape(names[0])} · after: '
            f'{escape(names[1])}</div><h1>The largest deviation in the volume went from {number(worst.before)} to '
            f'{number(worst.after)} µm (U = {number(worst.after_spread)} µm, 95 %).</h1>'
            f'<p><span class="badge {BADGE[found.decision]}">{escape(found.decision)}</span></p>'
            '<p class="lead">Decided by ISO 14253-1: a figure conforms where it lies inside its tolerance by its U or '
            'more, does not where it lies outside by more than U, and is undecided between.</p></header>')
    rows = [[escape(NAMES.get(f.name, f.name)), UNITS[f.unit], number(f.before), number(f.before_spread),
             f'<b>{number(f.after)}</b>', number(f.after_spread), number(f.tolerance), escape(f.decision)]
            for f in found.figures]
    head += ('<h2>Figures</h2><p>Of the 21 errors the largest absolute value. U of k = 2, of the volumetric error '
             '95 %.</p>') + table(
        ['figure', 'unit', '>before', '>U', '>after', '>U', '>tolerance', 'decision'], rows)
    if found.agreement is not None:
        kind = '' if found.agreement.agrees else ' warn2'
        head += ('<h2>Against the prediction</h2>'
                 f'<div class="todo{kind}">{escape(agreement_words(found.agreement))}.</div>')
    body = [head]
    with matplotlib.rc_context(STYLE):
        if all(np.ptp(found.after.points[:, axis]) > 0.0 for axis in range(3)):
            drawing = Figure(figsize=(13.5, 6.6))
            draw_planes(drawing, {'before': found.before, 'after': found.after}, 0.90)
            body.append('<h2>In the volume</h2>' + figure(
                svg(drawing), 'Size of the deviation in three planes, one scale of colours.', 1))
        body.append('<h2>The 21 errors</h2>' + figure(
            svg(draw_calibration(after, before.errors, 'before')), 'After, with a band of k = 2; dashed: before.', 2))
    if notes:
        body.append('<h2>Notes</h2><ul>' + ''.join(f'<li>{escape(note)}</li>' for note in notes) + '</ul>')
    return page(f'{found.machine.name}: {found.decision}', '\n'.join(body))
