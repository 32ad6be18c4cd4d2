"""The page of an evaluation: the 21 errors, how well they are known, the residuals, what the log leaves open."""

from collections.abc import Mapping
from html import escape
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.compensate.largest import largest_of_all
from stepdiag_ros.estimate.contributions import contribution_words
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.traceability import WORDS
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS
from stepdiag_ros.model.sensor import Misalignment
from stepdiag_ros.report.closure_section import closure_section
from stepdiag_ros.report.figures import draw_calibration
from stepdiag_ros.report.page import figure, page, table
from stepdiag_ros.report.plots import AFTER, STYLE, svg
from stepdiag_ros.report.words import CHANNEL_NAMES, plain, quantity, setup_words

GOOD, DOUBTFUL = 1.15, 1.5
"""Reduced χ² up to which a log agrees with the model, and from which it clearly does not."""
SQUARE_WORDS = {'EC0Y': 'Y to X', 'EB0Z': 'Z to X', 'EA0Z': 'Z to Y'}


def evaluation_page(solution: Solution, description: Description, name: str) -> str:
    """The HTML of one evaluation."""
    sections = [_head(solution, description, name), _tied(solution), _curves(solution), _squareness(solution),
                _misalignments(solution, description), _residuals(solution), closure_section(solution.closure, 3),
                _parts(solution), _open(solution), _notes(solution), _small_print(solution)]
    return page(f'{name}: the 21 geometric errors', '\n'.join(s for s in sections if s))


def _head(solution: Solution, description: Description, name: str) -> str:
    chi2 = solution.reduced_chi2
    if solution.status != 'ok':
        badge = ('bad', solution.status)
    elif chi2 is None or chi2 <= GOOD:
        badge = ('good', 'log and model agree')
    elif chi2 <= DOUBTFUL:
        badge = ('warn', 'log and model agree roughly')
    else:
        badge = ('bad', 'log and model disagree: see `stepdiag gap` before using this')
    size, spread, place = largest_of_all(solution, description.machine)
    sentence = (f'The machine misses by up to {quantity(size, "m", spread)} (95 %) in its volume of '
                + ' × '.join(plain(v * 1e3) for v in description.machine.volume) + ' mm.')
    said = '' if chi2 is None else (f'<p class="lead">Reduced χ² {plain(chi2)} over {solution.dof} degrees of '
                                    'freedom; 1 is what noise alone gives.</p>')
    said += (f'<p>Largest at ({", ".join(plain(1e3 * c) for c in place)}) mm, of all knots and corners'
             + ('.' if solution.traceability is None else f'; {escape(solution.traceability.temperature_words)}.')
             + '</p>')
    return (f'<header><div class="kicker">Machine {escape(description.machine.name)} · log {escape(name)} · chain '
            f'{escape(description.machine.chain)} · method {escape(solution.method)}</div>'
            f'<h1>{escape(sentence)}</h1><p><span class="badge {badge[0]}">{escape(badge[1])}</span></p>{said}'
            '</header>')


def _tied(solution: Solution) -> str:
    """How lengths and temperature are tied to the metre and to 20 °C."""
    tied = solution.traceability
    if tied is None:
        return ''
    rows = [['lengths', escape(WORDS[tied.air])], ['mean index of air', f'{tied.index:.8f}'],
            ['U of the unit of length (k = 2)', f'{plain(2e6 * tied.index_sigma)} µm/m'],
            ['positioning errors', escape(tied.temperature_words)], ['parts', escape(tied.workpiece_words)],
            ['uncertainty', f'the whole budget ({escape(tied.budget)}), k = 2']]
    rows += [[f'correction of {name} to 20 °C, at its end (k = 2)',
              quantity(float(values[-1]), 'm', 2.0 * float(tied.correction_sigma_m[name][-1]))]
             for name, values in tied.correction_m.items()]
    remarks = ''.join(f'<li>{escape(remark)}</li>' for remark in tied.remarks)
    return '<h2>What the numbers rest on</h2>' + table(['', ''], rows) + (f'<ul>{remarks}</ul>' if remarks else '')


def _curves(solution: Solution) -> str:
    with matplotlib.rc_context(STYLE):
        drawing = svg(draw_calibration(solution))
    rows = []
    for name in CURVES:
        if solution.has(name):
            _, value, sigma = solution.curve(name)
            unit = 'm' if name[1] in AXES else 'rad'
            rows.append([name, quantity(float(np.ptp(value)), unit), quantity(float(value[-1]), unit),
                         quantity(2.0 * float(np.max(sigma)), unit),
                         quantity(2.0 * float(np.max(solution.curve_repeatability(name))), unit)])
    body = table(['error', '>from lowest to highest', '>at the end', '>U at most (k = 2)', '>of it by repeats'], rows)
    return ('<h2>The 18 error curves</h2>'
            + figure(drawing, 'Rows: the axis that moves. Columns: what it does besides. Bands of k = 2. '
                     'Right: squareness.', 1)
            + f'<details><summary>as numbers</summary>{body}</details>')


def _squareness(solution: Solution) -> str:
    rows = [[name, SQUARE_WORDS[name], quantity(*_with_unit(solution, name)),
             quantity(abs(solution.squareness(name)[0]) * 0.1, 'm')]
            for name in SQUARENESS if solution.has(name)]
    return '' if not rows else '<h2>Squareness</h2>' + table(
        ['error', 'of', '>angle ± U (k = 2)', '>that is, over 100 mm'], rows)


def _with_unit(solution: Solution, name: str) -> tuple[float, str, float]:
    value, sigma = solution.squareness(name)
    return value, 'rad', 2.0 * sigma


def _misalignments(solution: Solution, description: Description) -> str:
    stations = solution.extra.get('stations', {})
    mirrors = {name: m for name, m in solution.misalignments.items() if name not in stations}
    return (_mirrors(mirrors, solution, description) if mirrors else '') \
        + (_stations(stations, description) if stations else '')


def _stations(stations: Mapping[str, Mapping[str, Any]], description: Description) -> str:
    """Where stations were found to stand, their dead paths, with U by repeats."""
    rows = [[escape(name), *(f'{1e3 * x:.4f} ± {2e3 * u:.2g} mm' for x, u in zip(
        (*s['position_m'], s['dead_path_m']), (*s['sigma_m'], s['dead_path_sigma_m']), strict=True)),
        ', '.join(f'{1e3 * v:g}' for v in description.setups[name].tool_of(description.machine)) + ' mm']
        for name, s in stations.items()]
    return ('<h2>Where the stations stood</h2><p>Found together with the errors, from changes of length alone; '
            'U (k = 2) by repeats. The dead path is that of the first run.</p>'
            + table(['setup', '>X', '>Y', '>Z', '>dead path', '>tool to the retroreflector'], rows)
            + _beams({name: s['beam'] for name, s in stations.items() if 'beam' in s}))


def _beams(beams: Mapping[str, Mapping[str, Any]]) -> str:
    """How regulated beams were held on the retroreflector."""
    rows = [[escape(name), 'no light' if b['spot_rms_m'] is None else f'{1e6 * b["spot_rms_m"]:.3g} µm',
             'not measured' if b['angle_rms_rad'] is None else f'{1e6 * b["angle_rms_rad"]:.2g} µrad']
            for name, b in beams.items()]
    return '' if not beams else (
        '<h2>How the beams were held</h2><p>A detector held each of these beams on the retroreflector. What it missed '
        'shortens a length and is put back by the spot. Where its angles were measured, they are compared with the '
        'directions from the station found to the stops, up to a turn of the base.</p>'
        + table(['setup', '>spot while measuring, rms', '>angles from directions, rms'], rows))


def _mirrors(mirrors: Mapping[str, Misalignment], solution: Solution, description: Description) -> str:
    rows = []
    for name, m in mirrors.items():
        sigma = solution.misalignment_sigma.get(name)
        angles = ['not found'] * 4 if sigma is None else [
            quantity(angle, 'rad', 2.0 * s)
            for angle, s in zip((*m.laser, *m.mirror), (*sigma.laser, *sigma.mirror), strict=True)]
        rows.append([escape(name), escape(setup_words(description.setups[name])), *angles])
    return ('<h2>How laser and mirror were aligned</h2><p>Found together with the errors and taken out of them: '
            'small angles about the beam\'s sideways directions u and v, ± U (k = 2). A line along one axis does not '
            'find them: its beam lengthens readings to second order only, and its spots show mirror and beam '
            'together.</p>'
            + table(['setup', 'which', '>laser about u', '>about v', '>mirror about u', '>about v'], rows))


def _residuals(solution: Solution) -> str:
    left = solution.residuals
    if left is None:
        return ''
    with matplotlib.rc_context(STYLE):
        drawing = svg(_draw_residuals(solution))
    return '<h2>Residuals</h2>' + figure(
        drawing, 'Log minus model, in the order of measuring: length of the first beam, spot x and y. A pattern '
        'here is something that the model does not know; `stepdiag gap` says what.', 2)


def _draw_residuals(solution: Solution) -> Figure:
    left = solution.residuals
    values = np.column_stack([left.displacement_m[:, :1], left.spot_m]) * 1e6
    order = np.argsort(left.time_s, kind='stable')
    values, setup = values[order], left.setup[order]
    drawing = Figure(figsize=(11.5, 4.0), layout='constrained')
    axes = drawing.subplots(3, 1, sharex=True)
    for k, ax in enumerate(axes):
        ax.plot(values[:, k], '.', color=AFTER, markersize=3)
        ax.set_ylabel(f'{CHANNEL_NAMES[k]}  [µm]')
        for first in np.flatnonzero(setup[1:] != setup[:-1]) + 1:
            ax.axvline(first - 0.5, color='#c4cbd0', linewidth=0.7)
    for first in [0, *(np.flatnonzero(setup[1:] != setup[:-1]) + 1)]:
        if np.sum(setup == setup[first]) < 0.03 * len(setup):
            continue
        axes[0].annotate(f' {setup[first]}', (first, 1.0), xycoords=('data', 'axes fraction'), fontsize=7.5,
                         va='bottom')
    axes[-1].set_xlabel('stop, in the order of measuring')
    return drawing


def _parts(solution: Solution) -> str:
    """What each kind of setup contributed; empty where there is one kind only."""
    if not solution.parts:
        return ''
    rows = [[escape(part.kind), escape(', '.join(part.setups)), str(part.readings), f'{part.rms:.2f}',
             escape(contribution_words(part))] for part in solution.parts]
    return ('<h2>What each part contributed</h2><p>All parts are solved together. Factors are those of the standard '
            'uncertainty by repeats.</p>'
            + table(['kind', 'setups', '>readings', '>residuals / noise', 'what it brought'], rows))


def _open(solution: Solution) -> str:
    if not solution.unidentifiable:
        return '<h2>What the log leaves open</h2><p>Nothing: every direction is narrowed down by the data.</p>'
    reasons: dict[str, list[str]] = {}
    for direction in solution.unidentifiable:
        reasons.setdefault(direction.why, []).append(' + '.join(direction.names))
    rows = [[escape(', '.join(sorted(names))), escape(why)] for why, names in reasons.items()]
    return ('<h2>What the log leaves open</h2><p>These trade against each other, or hardly show; no reading of '
            'this log tells them.</p>' + table(['which', 'why'], rows))


def _notes(solution: Solution) -> str:
    if not solution.warnings:
        return ''
    return '<h2>Notes</h2><ul>' + ''.join(f'<li>{escape(w)}</li>' for w in solution.warnings) + '</ul>'


def _small_print(solution: Solution) -> str:
    parts = []
    for key, value in solution.noise.items():
        if isinstance(value, str):
            parts.append(f'{key}: {value}')
            continue
        said, _, unit = key.rpartition('_')
        parts.append(f'{said.replace("_", " ")} {quantity(float(value), unit)}')
    return (f'<footer><p>Reference lines: {escape(solution.gauge)}. Noise: {escape(", ".join(parts))}. Uncertainties '
            'are expanded ones of the whole budget, k = 2; bands likewise.</p></footer>')
