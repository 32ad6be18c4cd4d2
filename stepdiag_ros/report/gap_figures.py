"""The pictures of a diagnosis, as HTML with SVG that needs nothing from outside."""

from collections.abc import Mapping, Sequence

import numpy as np

from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.gap.noise.coherent_lines import Spectrum
from stepdiag_ros.model.description import Setup
from stepdiag_ros.model.machine import CURVES, SQUARENESS
from stepdiag_ros.report.panels import DOT, LEFT, RIGHT, Panel, legend, picture, side_by_side, span, wide
from stepdiag_ros.report.series import Inside, Series
from stepdiag_ros.report.words import CHANNEL_NAMES, K, quantity, setup_words

MEAN_OF = 8
UNKNOWN_SIGMA = 3e-4
"""A standard deviation [m, rad] near the prior that a curve is held to: the log does not tell it."""
ASTRAY = 6.0
"""A curve this much wider than the right one is let out of its panel."""
WIDTH, LEAST_WIDTH = 1092.0, 940.0
"""Width of a picture over the whole page, and that below which it scrolls [px]."""
MARGIN, GAP, EDGE = 62.0, 13.0, 6.0
"""Room left of a picture for the numbers, between panels, at the right edge [px]."""
FEWEST = 9
"""A setup of fewer stops is drawn as wide as one of so many."""
LETTER = 6.2
"""Width of a letter [px]."""


def _scale(values: np.ndarray) -> tuple[float, str]:
    size = np.nanmax(np.abs(values)) if np.isfinite(values).any() else 0.0
    return (1e3, 'mm') if size > 2e-3 else (1e6, 'µm') if size > 2e-7 else (1e9, 'nm')


def along_stops(parts: Series, table: StopTable, overlay: bool) -> str:
    """Panels channel × setup over the stop's number, forward ▸ and backward ◂.

    ``overlay``: log and simulator over each other, causes left in; else the residuals before and after.
    """
    names, present, alone = table.setup_names, _present(parts), not overlay and _unchanged(parts)
    shown = (parts.real, parts.simulated) if overlay else (parts.before, parts.after)
    counts = [int(table.index[table.setup == s].max()) + 1 for s in range(len(names))]
    wanted = np.array([max(count, FEWEST) for count in counts], dtype=float)
    width = max(WIDTH, MARGIN + 60.0 * len(names))
    widths = wanted * ((width - MARGIN - EDGE - GAP * (len(names) - 1)) / wanted.sum())
    lefts = MARGIN + np.concatenate([[0.0], np.cumsum(widths + GAP)[:-1]])
    panels = []
    for place, row in enumerate(present):
        factor, unit = _scale(np.stack(shown)[:, :, row])
        noise = [] if overlay else [K * factor * parts.sigma[:, row], -K * factor * parts.sigma[:, row]]
        y = span(*(factor * part[:, row] for part in shown), *noise)
        for s, count in enumerate(counts):
            spare = max(FEWEST - count, 0) / 8.0
            panel = Panel(lefts[s], 20.0 + 118.0 * place, widths[s], 104.0, (-0.6 - spare, count - 0.4 + spare), y)
            panel.frame(names[s] if place == 0 else '', '' if row != present[-1] else 'stop',
                        f'{CHANNEL_NAMES[row]} [{unit}]' if s == 0 else '',
                        ('x' if row == present[-1] else '') + ('y' if s == 0 else ''), most=min(count, 6),
                        counted=(0.0, max(count - 1.0, 0.5)))
            mine = np.flatnonzero(table.setup == s)
            mine = mine[np.lexsort((table.index[mine], table.direction[mine], table.repeat[mine], table.run[mine]))]
            if not overlay:
                _noise_band(panel, table.index[mine], parts.sigma[mine, row] * K * factor)
            _stops(panel, table, mine, [factor * part[mine, row] for part in shown], overlay, alone)
            panels.append(panel)
    height = 20.0 + 118.0 * len(present) + 16.0
    if overlay:
        said = [(DOT, 'real', 'machine (log, rigid-body machine taken off)'),
                ('line', 'after', 'simulator with what was found')]
    elif alone:
        said = [(RIGHT, 'after', 'forward'), (LEFT, 'after', 'backward'), ('band', 'noise', 'noise, ± 2σ')]
    else:
        said = [(RIGHT, 'before', 'before, forward'), (LEFT, 'before', 'before, backward'),
                (DOT, 'after', 'after (what was found is in the simulator)'), ('band', 'noise', 'noise, ± 2σ')]
    what = 'Machine and simulator' if overlay else 'Residuals'
    label = f'{what} at each stop: {", ".join(CHANNEL_NAMES[row] for row in present)} in {", ".join(names)}'
    least = float(np.clip(8.0 * wanted.sum(), 320.0, width - 150.0))
    return legend(said) + wide(picture(panels, width, height, label), least)


def _present(parts: Series) -> list[int]:
    """Channels that were measured."""
    return [c for c in range(3) if np.isfinite(parts.before[:, c]).any()]


def _unchanged(parts: Series) -> bool:
    """Whether nothing was added, so that there is no before and after."""
    return np.array_equal(parts.before, parts.after, equal_nan=True)


def _noise_band(panel: Panel, stop: np.ndarray, half: np.ndarray) -> None:
    """The noise at each stop: the spot's grows with the distance."""
    known = np.isfinite(half)
    places, of = np.unique(stop[known], return_inverse=True)
    if not len(places):
        return
    size = np.bincount(of, half[known]) / np.bincount(of)
    places = np.concatenate([[places[0] - 0.4], places, [places[-1] + 0.4]])
    size = np.concatenate([size[:1], size, size[-1:]])
    panel.band(places, -size, size, 'noise')


def _stops(panel: Panel, table: StopTable, rows: np.ndarray, values: list[np.ndarray], overlay: bool,
           alone: bool) -> None:
    """The readings of a setup's stops, sorted by run, repeat and direction."""
    stop, way, (first, second) = table.index[rows], table.direction[rows], values
    passes = 4 * table.run[rows] + way + 4 * (int(table.run.max()) + 1) * table.repeat[rows]
    if overlay:
        panel.points(stop, first, 'real', 2.2)
        panel.line(stop, second, 'after', 1.1, passes)
        return
    if not alone:
        panel.line(stop, first, 'before faint', 0.6, passes)
    for shape, mine in ((RIGHT, way > 0), (LEFT, way <= 0)):
        panel.points(stop[mine], (second if alone else first)[mine], 'after' if alone else 'before', shape=shape)
    if not alone:
        panel.points(stop, second, 'after', 2.2)


def over_time(parts: Series, table: StopTable, timed: bool = True) -> str:
    """Residuals before and after over the log's time, or over the order where its times are made up; setups marked."""
    present, alone, panels = _present(parts), _unchanged(parts), []
    minutes = _pauses_cut(table.time_s) / 60.0 if timed else np.argsort(np.argsort(table.time_s)).astype(float)
    axis = 'time of measuring [min]; pauses are cut short, above: when each setup began' if timed else \
        'order of measuring [stops]; the times of the log are made up'
    firsts = sorted(int(np.flatnonzero(table.setup == s)[0]) for s in np.unique(table.setup))
    for place, row in enumerate(present):
        factor, unit = _scale(np.stack([parts.before[:, row], parts.after[:, row]]))
        before, after = parts.before[:, row] * factor, parts.after[:, row] * factor
        noise = K * factor * parts.sigma[np.isfinite(parts.sigma[:, row]), row]
        noise = float(noise.mean()) if len(noise) else 0.0
        panel = Panel(MARGIN, 20.0 + 98.0 * place, WIDTH - MARGIN - EDGE, 84.0, span(minutes, room=0.02),
                      span(before, after, np.array([noise, -noise])))
        last = place == len(present) - 1
        panel.frame('', axis if last else '',
                    f'{CHANNEL_NAMES[row]} [{unit}]', 'xy' if last else 'y', most=12)
        panel.band(np.array(panel.x), np.full(2, -noise), np.full(2, noise), 'noise')
        for first in firsts:
            panel.upright(minutes[first])
        if place == 0:
            _begins(panel, table, firsts, minutes, timed)
        if not alone:
            panel.points(minutes, before, 'before', 2.6)
        panel.points(minutes, after, 'after', 2.6)
        panels.append(panel)
    said = [] if alone else [(DOT, 'before', 'before'), (DOT, 'after', 'after (what was found is in the simulator)')]
    label = f'Residuals over time: {", ".join(CHANNEL_NAMES[row] for row in present)}'
    return legend([*said, ('band', 'noise', 'noise, ± 2σ (mean)')]) + wide(
        picture(panels, WIDTH, 20.0 + 98.0 * len(present) + 16.0, label), LEAST_WIDTH)


def _begins(panel: Panel, table: StopTable, firsts: list[int], minutes: np.ndarray, timed: bool) -> None:
    """When each setup began, said above as far as there is room."""
    places = [*(float(panel.across(minutes[first])) for first in firsts), panel.width + EDGE]
    free = 0.0
    for first, at, end in zip(firsts, places, places[1:], strict=False):
        name = table.setup_names[table.setup[first]]
        after = [f'{name}, after {table.time_s[first] / 60:.0f} min'] if timed else []
        for said in (*after, name):
            if at >= free and (LETTER * len(said) < end - at or said == name):
                panel.say(at + 2.0, -6.0, said, 'ink')
                free = at + LETTER * len(said)
                break


def _pauses_cut(time_s: np.ndarray) -> np.ndarray:
    """Times with the long pauses between stops cut down, so that the runs stay wide enough to look at."""
    order = np.argsort(time_s, kind='stable')
    step = np.diff(time_s[order], prepend=time_s[order[0]])
    limit = max(20.0 * float(np.median(step)), 1e-9)
    cut = np.empty_like(time_s)
    cut[order] = np.cumsum(np.minimum(step, limit))
    return cut


def inside_stops(parts: Inside, table: StopTable) -> str:
    """How readings move while the machine stands still: mean profile by axis moved where that shows what was
    found, else the rate over the log; the channels in which it shows."""
    size = np.abs(np.nan_to_num(parts.simulated_profile)).max(axis=(0, 1))
    misfit = np.abs(np.nan_to_num(parts.profile - parts.simulated_profile)).max(axis=(0, 1))
    if np.any(size > 3.0 * misfit):
        return _courses(parts)
    return _rates(parts, table)


def spectra(found: Mapping[int, Spectrum]) -> str:
    """Power over that of most frequencies in the dwells of a channel each; the line that stands out is marked."""
    panels = []
    for place, (channel, one) in enumerate(found.items()):
        power, k = one.over_median, one.strongest
        panel = Panel(MARGIN, 10.0 + 160.0 * place, WIDTH - MARGIN - EDGE, 118.0, (0.0, float(one.hertz[-1])),
                      (0.0, 1.1 * float(power.max())))
        panel.frame('', 'frequency as sampled [Hz]', f'{CHANNEL_NAMES[channel]} [power / median]')
        panel.band(np.array(panel.x), np.zeros(2), np.ones(2), 'noise')
        panel.line(one.hertz, power, 'after', 1.0)
        at = float(panel.across(one.hertz[k]))
        left = at > 0.9 * panel.width
        panel.say(at + (-4.0 if left else 4.0), float(panel.down(power[k])) + 9.0, f'{one.hertz[k]:.3g} Hz', 'ink',
                  'end' if left else 'start', 11.0)
        panels.append(panel)
    label = f'Spectrum while the machine stands still: {", ".join(CHANNEL_NAMES[channel] for channel in found)}'
    return wide(picture(panels, WIDTH, 10.0 + 160.0 * len(panels), label), LEAST_WIDTH)


def _courses(parts: Inside) -> str:
    channel = int(np.argmax(np.abs(np.nan_to_num(parts.simulated_profile)).max(axis=(0, 1))))
    both = np.stack([parts.profile, parts.simulated_profile])[..., channel]
    factor, unit = _scale(both)
    drawings = []
    for k, letter in enumerate('XYZ'):
        panel = Panel(46.0, 20.0, 296.0, 130.0, span(parts.time * 1e3), span(both * factor))
        panel.frame(f'{CHANNEL_NAMES[channel]} after a move of {letter} [{unit}]', 'after the stop began [ms]')
        panel.line(parts.time * 1e3, both[1, k] * factor, 'after', 1.6)
        panel.points(parts.time * 1e3, both[0, k] * factor, 'real', 5.0)
        label = f'{CHANNEL_NAMES[channel]} inside the stops after moves of {letter}'
        drawings.append(picture([panel], 350.0, 178.0, label))
    return legend([(DOT, 'real', 'machine, mean of the stops'), ('line', 'after', 'simulator with what was found')]) \
        + side_by_side(drawings, 300.0)


def _rates(parts: Inside, table: StopTable) -> str:
    noise = np.nan_to_num(parts.rate - parts.simulated_rate).std(axis=0)
    shown = np.flatnonzero(np.nan_to_num(parts.simulated_rate).std(axis=0) > 0.1 * noise)
    shown = shown if len(shown) else np.array([0])
    minutes, panels = _pauses_cut(table.time_s) / 60.0, []
    order = np.lexsort((minutes, table.run))
    for place, channel in enumerate(shown):
        rate, simulated = parts.rate[:, channel] * 1e9, parts.simulated_rate[:, channel] * 1e9
        panel = Panel(MARGIN, 8.0 + 136.0 * place, WIDTH - MARGIN - EDGE, 122.0, span(minutes, room=0.02),
                      span(rate, simulated))
        last = place == len(shown) - 1
        panel.frame('', 'time of measuring [min], pauses cut short' if last else '',
                    f'{CHANNEL_NAMES[channel]} [nm/s]', 'xy' if last else 'y', most=12)
        panel.points(minutes, rate, 'soft faint', 2.4)
        panel.points(*_means_of(minutes, rate, table.run), 'real', 3.6)
        panel.line(minutes[order], simulated[order], 'after', 1.6, table.run[order])
        panels.append(panel)
    return legend([(DOT, 'soft', 'machine, each stop'), (DOT, 'real', f'machine, mean of {MEAN_OF} stops'),
                   ('line', 'after', 'simulator with what was found')]) + wide(
        picture(panels, WIDTH, 8.0 + 136.0 * len(shown) + 16.0, 'Rates inside the stops over time'), LEAST_WIDTH)


def _means_of(time: np.ndarray, values: np.ndarray, run: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of a few consecutive stops of a run."""
    found = []
    for r in np.unique(run):
        rows = np.flatnonzero((run == r) & np.isfinite(values))
        found += [(time[part].mean(), values[part].mean())
                  for part in np.array_split(rows, max(1, len(rows) // MEAN_OF)) if len(part)]
    return tuple(np.array(found).reshape(-1, 2).T)


def errors_before_after(before: Solution, after: Solution | None) -> str:
    """The 21 errors with k = 2 bands: without (``before``) and with the causes taken out (``after``)."""
    both = [(before, 'after')] if after is None else [(before, 'before'), (after, 'after')]
    said = [('line', 'after', 'value'), ('band', 'after faint', 'band of k = 2')] if after is None else \
        [('line', 'before', 'as a plain evaluation gives them'), ('line', 'after', 'with the causes taken out'),
         ('band', 'after faint', 'band of k = 2')]
    return (legend(said) + side_by_side([_curve(name, both) for name in CURVES], 165.0)
            + side_by_side([_square(name, both) for name in SQUARENESS], 300.0))


def _curve(name: str, both: list[tuple[Solution, str]]) -> str:
    """One of the 18 errors over its axis."""
    unit = 'µm' if name[1] in 'XYZ' else 'µrad'
    known = [(*solution.curve(name), colour) for solution, colour in both if solution.has(name)]
    label, place = f'{name} [{unit}]', (34.0, 20.0, 127.0, 84.0)
    if not known or any(np.max(sigma) > UNKNOWN_SIGMA for _, _, sigma, _ in known):
        panel = Panel(*place, (0.0, 1.0), (0.0, 1.0))
        panel.say(0.0, -6.0, label, 'ink title', size=11.0)
        panel.say(63.0, 46.0, 'not known from this log', anchor='middle')
        return picture([panel], 172.0, 134.0, f'{label}: not known from this log')
    curves = [(1e3 * x, 1e6 * value, 1e6 * K * sigma, colour) for x, value, sigma, colour in known]
    edges = [np.concatenate([value - half, value + half]) for _, value, half, _ in curves]
    astray = len(edges) == 2 and np.ptp(edges[0]) > ASTRAY * max(np.ptp(edges[1]), 1e-3)
    # A curve gone astray must not flatten the one that is right: it may leave the panel.
    y = span(edges[1], room=0.6, least=1e-3) if astray else span(*edges)
    panel = Panel(*place, span(*(x for x, *_ in curves), room=0.02), y)
    panel.frame(label, f'{name[2]} [mm]', most=5)
    for x, value, half, colour in curves:
        panel.band(x, value - half, value + half, colour, 0.18)
        panel.line(x, value, colour, 1.4)
    if astray:
        panel.say(125.0, 80.0, 'plain: off scale', 'before', 'end', 9.0)
    return picture([panel], 172.0, 134.0, f'{label} along {name[2]}')


def _square(name: str, both: list[tuple[Solution, str]]) -> str:
    """One of the three squareness errors, its value with U written above."""
    known = [(*solution.squareness(name), colour) for solution, colour in both if solution.has(name)]
    if not known:
        panel = Panel(8.0, 20.0, 334.0, 30.0, (0.0, 1.0), (0.0, 1.0))
        panel.say(0.0, -6.0, f'{name}: not known from this log', 'ink title', size=11.0)
        return picture([panel], 350.0, 54.0, f'{name}: not known from this log')
    ends = np.array([1e6 * (value + side * K * sigma) for value, sigma, _ in known for side in (-1.0, 1.0)])
    value, sigma, _ = known[-1]
    said = f'{name} squareness: {quantity(value, "rad", K * sigma)} (k = 2)'
    panel = Panel(8.0, 20.0, 334.0, 15.0 * len(known) + 4.0, span(ends, room=0.12), (len(known) - 0.4, -0.6))
    panel.frame(said, '[µrad]', '', 'x', 'x')
    for row, (value, sigma, colour) in enumerate(known):
        middle, half = 1e6 * value, 1e6 * K * sigma
        panel.line(np.array([middle - half, middle + half]), np.full(2, float(row)), colour, 1.6)
        panel.points(np.array([middle]), np.array([float(row)]), colour, 6.0)
    return picture([panel], 350.0, 15.0 * len(known) + 54.0, said)


def legend_of_setups(setups: Sequence[Setup]) -> str:
    """``ppp: diagonal …`` for the small print."""
    return '; '.join(f'{setup.name}: {setup_words(setup)}' for setup in setups)
