"""The part of an evaluation's page on drift: how each cycle came back to its first stop, with time and temperature."""

from collections.abc import Sequence
from datetime import UTC, datetime
from html import escape

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.estimate.closure import Closure, said
from stepdiag_ros.report.legends import legend_outside
from stepdiag_ros.report.page import figure, table
from stepdiag_ros.report.plots import AFTER, BEFORE, STYLE, svg
from stepdiag_ros.report.words import plain, quantity


def closure_section(found: Sequence[Closure], number: int) -> str:
    """HTML of the section; empty where the log holds no cycle.  ``number`` as :func:`figure` has it."""
    sentence = said(found)
    if not sentence:
        return ''
    with matplotlib.rc_context(STYLE):
        drawing = svg(draw(found))
    joined = any(one.reset_between for one in found)
    resets = ('<p>A reset of the interferometer lies between the forward and the backward run. They are joined at the '
              'last stop; what drifted there between their two readings is in no closure of the length.</p>'
              if joined else '<p>No reset lies between forward and backward.</p>')
    names = list(dict.fromkeys(name for one in found for name in one.temperature))
    head = ['setup', '>repeat', 'began', '>lasted', '>unseen at the reset', '>length ± U (k = 2)',
            '>spot x ± U (k = 2)', '>spot y ± U (k = 2)', *(f'>{escape(name)}, begin → end' for name in names)]
    rows = [_row(one, names) for one in found]
    numbers = table(head, rows)
    none = '' if names else '<p>The log holds no temperatures.</p>'
    return (f'<h2>Drift: does each cycle return to its zero?</h2><p>{escape(sentence)}.</p>{resets}{none}'
            + figure(drawing, 'Reading at a cycle\'s first stop when the machine comes back to it, less the reading '
                     'when it left; bars of U (k = 2) by readings and repeatability of arrival. Beyond the bars is '
                     'drift, or a reversal error where the stop was first approached from the other side. One in '
                     'twenty lies beyond by chance.', number)
            + f'<details><summary>as numbers</summary>{numbers}</details>')


def _row(one: Closure, names: list[str]) -> list[str]:
    began = datetime.fromtimestamp(one.time_ns[0] * 1e-9, UTC).strftime('%Y-%m-%d %H:%M:%S')
    began, lasted = (began, f'{plain(one.duration_s)} s') if one.timed else ('not stated', 'not stated')
    lengths = [quantity(one.length_m, 'm', 2.0 * one.length_sigma_m),
               *(quantity(float(v), 'm', 2.0 * float(s)) for v, s in zip(one.spot_m, one.spot_sigma_m, strict=True))]
    warm = [f'{one.temperature[name][0]:.2f} → {one.temperature[name][1]:.2f} °C' if name in one.temperature else ''
            for name in names]
    unseen = f'{plain(one.unseen_s)} s' if one.reset_between else 'no reset'
    return [escape(one.setup), str(one.repeat), began, lasted, unseen, *lengths, *warm]


def draw(found: Sequence[Closure]) -> Figure:
    """Closures of the length over time, and below them the temperatures at begin and end of each cycle."""
    names = list(dict.fromkeys(name for one in found for name in one.temperature))
    drawing = Figure(figsize=(11.5, 4.4 if names else 2.9), layout='constrained')
    axes = np.atleast_1d(drawing.subplots(2 if names else 1, 1, sharex=True))
    minutes = np.array([one.start_s + one.duration_s for one in found]) / 60.0
    for reset, colour, words in ((False, AFTER, 'no reset between'), (True, BEFORE, 'joined over a reset')):
        mine = np.flatnonzero([one.reset_between == reset for one in found])
        if mine.size:
            axes[0].errorbar(minutes[mine], [1e6 * found[i].length_m for i in mine],
                             [2e6 * found[i].length_sigma_m for i in mine], fmt='o', color=colour, markersize=3.5,
                             elinewidth=0.9, capsize=2, label=words)
    axes[0].axhline(0.0, color='#aab2b8', linewidth=0.8)
    axes[0].set_ylabel('closure of the length  [µm]')
    last = ''
    for one, when in zip(found, minutes, strict=True):
        if one.setup != last:
            axes[0].annotate(one.setup, (when, 1.0), xycoords=('data', 'axes fraction'), fontsize=7, va='bottom')
        last = one.setup
    handles, labels = axes[0].get_legend_handles_labels()
    for name in names:
        pairs = [(t, v) for one in found if name in one.temperature for t, v in zip(
            (one.start_s, one.start_s + one.duration_s), one.temperature[name], strict=True)]
        handles += axes[1].plot([t / 60.0 for t, _ in pairs], [v for _, v in pairs], '-o', markersize=2.6,
                                linewidth=1.0)
        labels.append(f'temperature: {name}')
    if names:
        axes[1].set_ylabel('temperature  [°C]')
    axes[-1].set_xlabel('time since the first dwell  [min]' if found[0].timed else
                        'order of the cycles (the times of the log are made up)')
    if not found[0].timed:
        axes[-1].set_xticks([])
    legend_outside(drawing, handles, labels, 'lower left', ncols=4, fontsize=8.5)
    return drawing
