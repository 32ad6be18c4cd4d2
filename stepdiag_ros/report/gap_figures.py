"""The pictures of a diagnosis, as SVG text that needs nothing from outside."""

import io
import re
from collections.abc import Mapping, Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.gap.noise.coherent_lines import Spectrum
from stepdiag_ros.model.description import Setup
from stepdiag_ros.model.machine import CURVES, SQUARENESS
from stepdiag_ros.report.legends import legend_outside
from stepdiag_ros.report.series import Inside, Series
from stepdiag_ros.report.words import setup_words

INK, SOFT, GRID = '#22282e', '#6b747c', '#e4e7ea'
BEFORE, AFTER, NOISE, REAL = '#c2572f', '#17688a', '#dfe5e9', '#22282e'
STYLE = {'font.family': 'sans-serif', 'font.size': 8.5, 'text.color': INK, 'axes.edgecolor': '#aab2b8',
         'axes.labelcolor': SOFT, 'xtick.color': SOFT, 'ytick.color': SOFT, 'axes.linewidth': 0.7,
         'axes.spines.top': False, 'axes.spines.right': False, 'axes.grid': True, 'grid.color': GRID,
         'grid.linewidth': 0.6, 'axes.axisbelow': True, 'svg.hashsalt': 'stepdiag', 'svg.fonttype': 'path',
         'axes.titlesize': 9, 'axes.titleweight': 'bold', 'axes.titlelocation': 'left',
         'xtick.major.size': 2.5, 'ytick.major.size': 2.5, 'legend.frameon': False}
CHANNEL_NAMES = ('length', 'spot x', 'spot y')
K = 2.0
MEAN_OF = 8
UNKNOWN_SIGMA = 3e-4
"""A standard deviation [m, rad] near the prior that a curve is held to: the log does not tell it."""
ASTRAY = 6.0
"""A curve this much wider than the right one is let out of its panel."""


def svg(figure: Figure) -> str:
    """A figure as an ``<svg>`` element."""
    buffer = io.StringIO()
    figure.savefig(buffer, format='svg', metadata={'Date': None, 'Creator': None}, transparent=True)
    text = re.sub(r'<metadata>.*?</metadata>', '', buffer.getvalue(), flags=re.S)
    return re.sub(r' (width|height)="[\d.]+pt"', '', text[text.index('<svg'):], count=2)


def styled(draw):
    """A drawing function under the pages' style, back as SVG text."""
    def drawn(*args, **kwargs) -> str:
        with matplotlib.rc_context(STYLE):
            return svg(draw(*args, **kwargs))
    drawn.__doc__ = draw.__doc__
    return drawn


def _scale(values: np.ndarray) -> tuple[float, str]:
    size = np.nanmax(np.abs(values)) if np.isfinite(values).any() else 0.0
    return (1e3, 'mm') if size > 2e-3 else (1e6, 'µm') if size > 2e-7 else (1e9, 'nm')


@styled
def along_stops(parts: Series, table: StopTable, overlay: bool) -> Figure:
    """Panels channel × setup over the stop's number, forward ▸ and backward ◂.

    ``overlay``: log and simulator over each other, causes left in; else the residuals before and after.
    """
    names = table.setup_names
    # Where nothing was added there is no before and after.
    alone = not overlay and np.array_equal(parts.before, parts.after, equal_nan=True)
    counts = [int(table.index[table.setup == s].max()) + 1 for s in range(len(names))]
    present = _present(parts)
    figure = Figure(figsize=(11.5, 0.8 + 1.6 * len(present)), layout='constrained')
    axes = figure.subplots(len(present), len(names), sharey='row', squeeze=False,
                           gridspec_kw={'width_ratios': [max(c, 9) for c in counts]})
    for place, row in enumerate(present):
        channel = CHANNEL_NAMES[row]
        shown = (parts.real, parts.simulated) if overlay else (parts.before, parts.after)
        factor, unit = _scale(np.stack(shown)[:, :, row])
        for s in range(len(names)):
            ax = axes[place, s]
            mine = table.setup == s
            if not overlay:
                _noise_band(ax, table.index[mine], parts.sigma[mine, row] * K * factor)
            for run in np.unique(table.run[mine]):
                for repeat, way in sorted({(int(r), int(d)) for r, d in zip(
                        table.repeat[table.run == run], table.direction[table.run == run], strict=True)}):
                    rows = np.flatnonzero((table.run == run) & (table.repeat == repeat)
                                          & (table.direction == way))
                    _panel_lines(ax, table.index[rows], [part[rows, row] * factor for part in shown],
                                 way, overlay, alone)
            ax.tick_params(labelsize=7)
            if counts[s] < 9:
                ax.set_xticks(range(0, counts[s], max(1, counts[s] - 1)))
                ax.set_xlim(-0.4 - (9 - counts[s]) / 8, counts[s] - 0.6 + (9 - counts[s]) / 8)
            if place == 0:
                ax.set_title(names[s], fontsize=8.5)
            if row == present[-1]:
                ax.set_xlabel('stop' if counts[s] >= 9 else '', fontsize=7.5)
        axes[place, 0].set_ylabel(f'{channel}  [{unit}]')
    if overlay:
        handles = [_mark(REAL, 'o'), _line(AFTER)]
        labels = ['machine (log, rigid-body machine taken off)', 'simulator with what was found']
    elif alone:
        handles = [_mark(AFTER, '>'), _mark(AFTER, '<'), matplotlib.patches.Patch(color=NOISE)]
        labels = ['forward', 'backward', 'noise, ± 2σ']
    else:
        handles = [_mark(BEFORE, '>'), _mark(BEFORE, '<'), _mark(AFTER, 'o'),
                   matplotlib.patches.Patch(color=NOISE)]
        labels = ['before, forward', 'before, backward', 'after (what was found is in the simulator)',
                  'noise, ± 2σ']
    legend_outside(figure, handles, labels, 'upper left', ncols=4, fontsize=8.5)
    return figure


def _present(parts: Series) -> list[int]:
    """Channels that were measured."""
    return [c for c in range(3) if np.isfinite(parts.before[:, c]).any()]


def _mark(colour: str, shape: str):
    return matplotlib.lines.Line2D([], [], color=colour, marker=shape, linestyle='', markersize=4)


def _line(colour: str):
    return matplotlib.lines.Line2D([], [], color=colour, linewidth=1.6)


def _noise_band(ax, stop: np.ndarray, half: np.ndarray) -> None:
    """The noise at each stop: the spot's grows with the distance."""
    places = np.unique(stop[np.isfinite(half)])
    if not len(places):
        return
    size = np.array([np.nanmean(half[stop == p]) for p in places])
    if len(places) == 1:
        places, size = places[0] + np.array([-0.5, 0.5]), np.repeat(size, 2)
    ax.fill_between(places, -size, size, color=NOISE, linewidth=0, zorder=0.5)


def _panel_lines(ax, stop: np.ndarray, values: list[np.ndarray], way: int, overlay: bool,
                 alone: bool) -> None:
    order = np.argsort(stop)
    stop, (first, second) = stop[order], [v[order] for v in values]
    if overlay:
        ax.plot(stop, first, 'o', color=REAL, markersize=1.7, alpha=0.75, markeredgewidth=0)
        ax.plot(stop, second, '-', color=AFTER, linewidth=1.0, alpha=0.9)
    elif alone:
        ax.plot(stop, second, '>' if way > 0 else '<', color=AFTER, markersize=2.4, alpha=0.9, markeredgewidth=0)
    else:
        ax.plot(stop, first, '-', color=BEFORE, linewidth=0.5, alpha=0.45)
        ax.plot(stop, first, '>' if way > 0 else '<', color=BEFORE, markersize=2.2, alpha=0.85,
                markeredgewidth=0)
        ax.plot(stop, second, 'o', color=AFTER, markersize=1.6, alpha=0.85, markeredgewidth=0)


@styled
def over_time(parts: Series, table: StopTable) -> Figure:
    """Residuals before and after over the log's time; setups marked."""
    present = _present(parts)
    figure = Figure(figsize=(11.5, 0.6 + 1.2 * len(present)), layout='constrained')
    axes = figure.subplots(len(present), 1, sharex=True, squeeze=False)[:, 0]
    minutes = _pauses_cut(table.time_s) / 60.0
    for ax, row in zip(axes, present, strict=True):
        channel = CHANNEL_NAMES[row]
        factor, unit = _scale(np.stack([parts.before[:, row], parts.after[:, row]]))
        known = parts.sigma[np.isfinite(parts.sigma[:, row]), row]
        if len(known):
            noise = K * float(known.mean()) * factor
            ax.axhspan(-noise, noise, color=NOISE, linewidth=0, zorder=0.5)
        ax.plot(minutes, parts.before[:, row] * factor, '.', color=BEFORE, markersize=3.2, markeredgewidth=0,
                label='before')
        ax.plot(minutes, parts.after[:, row] * factor, '.', color=AFTER, markersize=3.2, markeredgewidth=0,
                label='after')
        ax.set_ylabel(f'{channel}  [{unit}]')
        ax.grid(axis='x', visible=False)
        for s in np.unique(table.setup):
            first = int(np.flatnonzero(table.setup == s)[0])
            begin = minutes[first]
            ax.axvline(begin, color='#c4cbd0', linewidth=0.7)
            if row == present[0]:
                said = f' {table.setup_names[s]}'
                if np.ptp(minutes[table.setup == s]) > 0.09 * np.ptp(minutes):
                    said += f', after {table.time_s[first] / 60:.0f} min'
                ax.annotate(said, (begin, 1.0), xycoords=('data', 'axes fraction'), fontsize=7.5,
                            color=SOFT, va='bottom')
    axes[-1].set_xlabel('time of measuring  [min]; pauses are cut short, above: when each setup began')
    return figure


def _pauses_cut(time_s: np.ndarray) -> np.ndarray:
    """Times with the long pauses between stops cut down, so that the runs stay wide enough to look at."""
    order = np.argsort(time_s, kind='stable')
    step = np.diff(time_s[order], prepend=time_s[order[0]])
    limit = max(20.0 * float(np.median(step)), 1e-9)
    cut = np.empty_like(time_s)
    cut[order] = np.cumsum(np.minimum(step, limit))
    return cut


@styled
def inside_stops(parts: Inside, table: StopTable) -> Figure:
    """How readings move while the machine stands still: mean profile by axis moved where that shows what was
    found, else the rate over the log; the channels in which it shows."""
    size = np.abs(np.nan_to_num(parts.simulated_profile)).max(axis=(0, 1))
    misfit = np.abs(np.nan_to_num(parts.profile - parts.simulated_profile)).max(axis=(0, 1))
    if np.any(size > 3.0 * misfit):
        return _courses(parts)
    return _rates(parts, table)


@styled
def spectra(found: Mapping[int, Spectrum]) -> Figure:
    """Power over that of most frequencies in the dwells of a channel each; the line that stands out is marked."""
    figure = Figure(figsize=(11.5, 0.4 + 2.0 * len(found)), layout='constrained')
    for ax, (channel, one) in zip(figure.subplots(len(found), 1, squeeze=False)[:, 0], found.items(), strict=True):
        power, k = one.over_median, one.strongest
        ax.axhspan(0.0, 1.0, color=NOISE, linewidth=0, zorder=0.5)
        ax.plot(one.hertz, power, '-', color=AFTER, linewidth=0.8)
        ax.annotate(f'{one.hertz[k]:.3g} Hz', (one.hertz[k], power[k]), xytext=(4, -6), textcoords='offset points',
                    color=INK)
        ax.set(xlim=(0.0, float(one.hertz[-1])), xlabel='frequency as sampled  [Hz]',
               ylabel=f'{CHANNEL_NAMES[channel]}  [power / median]')
        ax.set_ylim(0.0, 1.1 * float(power.max()))
    return figure


def _courses(parts: Inside) -> Figure:
    figure = Figure(figsize=(11.5, 2.6), layout='constrained')
    channel = int(np.argmax(np.abs(np.nan_to_num(parts.simulated_profile)).max(axis=(0, 1))))
    factor, unit = _scale(np.stack([parts.profile, parts.simulated_profile])[..., channel])
    for k, (ax, letter) in enumerate(zip(figure.subplots(1, 3, sharey=True), 'XYZ', strict=True)):
        ax.plot(parts.time * 1e3, parts.profile[k, :, channel] * factor, 'o', color=REAL, markersize=5,
                markeredgewidth=0)
        ax.plot(parts.time * 1e3, parts.simulated_profile[k, :, channel] * factor, '-', color=AFTER, linewidth=1.5)
        ax.set_title(f'{CHANNEL_NAMES[channel]} after a move of {letter}  [{unit}]')
        ax.set_xlabel('after the stop began [ms]')
    return figure


def _rates(parts: Inside, table: StopTable) -> Figure:
    noise = np.nan_to_num(parts.rate - parts.simulated_rate).std(axis=0)
    shown = np.flatnonzero(np.nan_to_num(parts.simulated_rate).std(axis=0) > 0.1 * noise)
    shown = shown if len(shown) else np.array([0])
    figure = Figure(figsize=(11.5, 1.0 + 1.7 * len(shown)), layout='constrained')
    minutes = _pauses_cut(table.time_s) / 60.0
    for ax, channel in zip(figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0], shown, strict=True):
        ax.plot(minutes, parts.rate[:, channel] * 1e9, '.', color='#a9b3ba', markersize=2.6, markeredgewidth=0,
                label='machine, each stop')
        mean_time, mean = _means_of(minutes, parts.rate[:, channel] * 1e9, table.run)
        ax.plot(mean_time, mean, 'o', color=REAL, markersize=3.6, markeredgewidth=0,
                label=f'machine, mean of {MEAN_OF} stops')
        for run in np.unique(table.run):
            rows = table.run == run
            ax.plot(minutes[rows], parts.simulated_rate[rows, channel] * 1e9, '-', color=AFTER, linewidth=1.5,
                    label='simulator with what was found' if run == table.run[0] else None)
        ax.set_ylabel(f'{CHANNEL_NAMES[channel]}  [nm/s]')
    legend_outside(figure, *figure.axes[0].get_legend_handles_labels(), 'upper left', ncols=3)
    figure.axes[-1].set_xlabel('time of measuring  [min], pauses cut short')
    return figure


def _means_of(time: np.ndarray, values: np.ndarray, run: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of a few consecutive stops of a run."""
    found = []
    for r in np.unique(run):
        rows = np.flatnonzero((run == r) & np.isfinite(values))
        found += [(time[part].mean(), values[part].mean())
                  for part in np.array_split(rows, max(1, len(rows) // MEAN_OF)) if len(part)]
    return tuple(np.array(found).T)


@styled
def errors_before_after(before: Solution, after: Solution | None) -> Figure:
    """The 21 errors with k = 2 bands: without (``before``) and with the causes taken out (``after``)."""
    figure = Figure(figsize=(11.5, 7.6), layout='constrained')
    upper, lower = figure.subfigures(2, 1, height_ratios=(4.3, 1.0))
    axes, square = upper.subplots(3, 6), lower.subplots(1, 3)
    both = [(before, BEFORE, 'without'), (after, AFTER, 'with')] if after is not None else \
        [(before, AFTER, 'with')]
    for place, name in enumerate(CURVES):
        ax = axes[place // 6, place % 6]
        for solution, colour, _ in both:
            if solution.has(name) and np.max(solution.curve(name)[2]) > UNKNOWN_SIGMA:
                ax.annotate('not known from this log', (0.5, 0.5), xycoords='axes fraction', ha='center',
                            fontsize=7, color=SOFT)
                break
            if solution.has(name):
                position, value, sigma = solution.curve(name)
                ax.fill_between(position * 1e3, (value - K * sigma) * 1e6, (value + K * sigma) * 1e6,
                                color=colour, alpha=0.18, linewidth=0)
                ax.plot(position * 1e3, value * 1e6, '-', color=colour, linewidth=1.3)
        ax.set_title(f'{name}  [{"µm" if name[1] in "XYZ" else "µrad"}]', fontsize=8.5)
        ax.tick_params(labelsize=7)
        if after is not None:
            _keep_legible(ax, after, before, name)
        if place // 6 == 2:
            ax.set_xlabel('position [mm]', fontsize=7.5)
    for ax, name in zip(square, SQUARENESS, strict=True):
        rows = [b for b in both if b[0].has(name)]
        for row, (solution, colour, _) in enumerate(rows):
            value, sigma = solution.squareness(name)
            ax.errorbar([value * 1e6], [row], xerr=[K * sigma * 1e6], fmt='o', color=colour, capsize=3)
        ax.set_yticks(range(len(rows)), [b[2] for b in rows] if len(rows) > 1 else [''])
        ax.set_ylim(len(rows) - 0.4, -0.6)
        ax.set_title(f'{name}  squareness [µrad]', fontsize=8.5)
        ax.tick_params(labelsize=7)
    if after is not None:
        legend_outside(figure, [_line(BEFORE), _line(AFTER)],
                       ['as a plain evaluation gives them', 'with the causes taken out'], 'upper left', ncols=2)
    return figure


def _keep_legible(ax, after: Solution, before: Solution, name: str) -> None:
    """A curve gone astray must not flatten the one that is right: it may leave the panel."""
    if not (after.has(name) and before.has(name)):
        return
    _, value, sigma = after.curve(name)
    low, high = np.min(value - K * sigma) * 1e6, np.max(value + K * sigma) * 1e6
    wide = max(high - low, 1e-3)
    _, astray, unsure = before.curve(name)
    if np.max(astray + K * unsure) - np.min(astray - K * unsure) > ASTRAY * wide * 1e-6:
        ax.set_ylim(low - 0.6 * wide, high + 0.6 * wide)
        ax.annotate('without: off scale', (0.97, 0.04), xycoords='axes fraction', ha='right', fontsize=6.5,
                    color=BEFORE)


def legend_of_setups(setups: Sequence[Setup]) -> str:
    """``ppp: diagonal …`` for the small print."""
    return '; '.join(f'{setup.name}: {setup_words(setup)}' for setup in setups)
