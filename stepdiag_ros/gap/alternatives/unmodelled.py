"""Structure of no known cause: what "something else" may look like.

Unmodelled structure: broad patterns in the three channels.  They stand against the named effects with the
same price of complexity, so that a name must predict the log better than a shapeless pattern
does, and what a name leaves behind is noticed although no name fits it.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from stepdiag_ros.effects.base import Form, StopView
from stepdiag_ros.effects.made import Made, Product, Split
from stepdiag_ros.effects.patterns import at_most
from stepdiag_ros.gap.preprocess.observe import channels

NAME = 'unknown'
LEAN = ('jumps', 'lengths')
"""Families whose forms have one column each: they hold as exactly as a name's do, and are doubted less."""
LEAST_STOPS = 5
"""A run of fewer stops has none to spare for a course of its own."""


def unknown_families(view: StopView) -> dict[str, list[Form]]:
    """All unmodelled patterns of a log by family; families count alike, however many they are."""
    return {'places': list(_static(view)), 'times': list(_in_time(view)),
            'jumps': list(_jumps(view)), 'tool': list(lasting_jumps(view, 'tool point', view.by_shift, 1e-6)),
            'dwells': list(_inside(view)), 'lengths': list(_lengths(view)),
            'channels': list(_between_channels(view))}


def _channels(view: StopView) -> list[tuple[str, slice, float]]:
    """Channel groups: name, columns, typical size [m]."""
    return [(name, columns, 1e-6 if name == 'displacement' else 3e-6) for name, columns in channels(view.beams).items()]


def pattern_form(view: StopView, label: str, patterns: np.ndarray, columns: slice, scale: float) -> Form:
    """Patterns (k, n), or (k, n, c) of their own in each, put into c channels."""
    full = Made((len(patterns), *view.reading.shape), _put, view.reading.shape, patterns, columns)
    return numbered_form(label, full, scale)


def numbered_form(label: str, columns: np.ndarray | Made, scale: float, units: str = 'm') -> Form:
    """Columns (k, n, c) of one typical size that have numbers for names."""
    return Form(label, columns, tuple(str(i) for i in range(len(columns))), np.full(len(columns), scale), units)


def _in_channels(view: StopView, columns: slice) -> np.ndarray:
    """Which channels (1, c) are among some."""
    channels = np.zeros((1, view.reading.shape[1]), bool)
    channels[0, columns] = True
    return channels


def _in_all_channels(view: StopView, courses: np.ndarray) -> np.ndarray:
    """Courses (k, n), alike in all channels (k, n, c)."""
    return courses[:, :, None] * np.ones(view.reading.shape[1])


def _put(shape: tuple[int, int], patterns: np.ndarray, columns: slice) -> np.ndarray:
    full = np.zeros((len(patterns), *shape))
    full[:, :, columns] = patterns if patterns.ndim == 3 else np.asarray(patterns)[:, :, None]
    return full


def _standing(stops: int, at: np.ndarray) -> np.ndarray:
    """One at the stops ``at``, else nothing: (1, n)."""
    pattern = np.zeros((1, stops))
    pattern[0, at] = 1.0
    return pattern


def _times(derivative: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Derivatives (k, n, c) at the stops ``at``, else nothing."""
    columns = np.zeros(derivative.shape)
    columns[:, at] = derivative[:, at]
    return columns


def _static(view: StopView) -> Iterator[Form]:
    """Errors that belong to a place: to a stop of a setup, alike or opposite in the two directions."""
    place = view.setup * 100000 + view.index
    for name, columns, scale in _channels(view):
        channels = _in_channels(view, columns)
        for what, sign in (('places', np.ones(len(place))), ('places by direction', view.direction)):
            course = _in_all_channels(view, sign[None])
            # All of them first: those of one setup are some of their columns.
            yield numbered_form(f'{name}: {what}', Split(course, place, np.unique(place), channels), scale)
            for setup in range(len(view.setup_names)):
                mine = view.setup == setup
                if mine.sum() >= 8:
                    yield numbered_form(f'{name}: {what} in {view.setup_names[setup]}',
                                        Split(course, place, np.unique(place[mine]), channels), scale)
    # Few-parameter shapes along the travel, the same in all setups, by direction.
    share = view.commanded.T / np.array(view.description.machine.volume)[:, None]
    waves = np.concatenate([np.cos(np.pi * k * share) for k in (1, 2, 3)])
    for name, columns, scale in _channels(view):
        for setup in range(len(view.setup_names)):
            mine = (view.setup == setup).astype(float)
            if mine.sum() >= 8:
                yield pattern_form(view, f'{name}: slow shape along {view.setup_names[setup]}',
                                   waves[::3] * mine, columns, scale)
        yield pattern_form(view, f'{name}: slow shape by direction', waves * view.direction, columns, scale)


def _in_time(view: StopView) -> Iterator[Form]:
    """Errors that belong to a time: inside a run, from run to run, over the whole log."""
    runs = np.unique(view.run)
    span = max(float(np.ptp(view.time)), 1e-9)
    scaled = 2.0 * (view.time - view.time.min()) / span - 1.0
    slow = np.stack([np.cos(np.pi * k * (scaled + 1.0) / 2.0) for k in range(1, 13)])
    counts = np.array([np.sum(view.run == run) for run in runs])
    long, ramp = runs[counts >= LEAST_STOPS], np.zeros(len(view.time))
    for run in long:
        time = view.run_time[view.run == run]
        ramp[view.run == run] = time / max(time.max(), 1e-9)
    for name, columns, scale in _channels(view):
        if len(long):
            for kind, courses in (('drift', np.stack([ramp, ramp**2])), ('ramp', ramp[None])):
                full = Split(_in_all_channels(view, courses), view.run, long, _in_channels(view, columns))
                yield numbered_form(f'{name}: {kind} inside the runs', full, scale)
        yield pattern_form(view, f'{name}: slow in time', slow, columns, scale)
        for setup in range(len(view.setup_names)):
            mine = (view.setup == setup).astype(float)
            if mine.sum() < 8:
                continue
            start = view.mount_time * mine
            start = start / max(start.max(), 1e-9)
            yield pattern_form(view, f'{name}: slow in time in {view.setup_names[setup]}',
                               np.stack([start, start**2, start**3]) * mine, columns, scale)
    # What the beam's direction does in time has a name, whatever its profile.
    for label, derivative, scale in (('tool point', view.by_shift, 1e-6), ('mirror', view.by_mirror, 1e-6)):
        for run_wise in (False, True):
            profiles = ([(view.run == run).astype(float) * view.run_time / 30.0 for run in runs]
                       if run_wise else list(slow))
            profiles = [c for c in profiles if np.any(c)]
            columns = Product(np.array(profiles), derivative)
            yield numbered_form(f'{label}: wandering {"inside the runs" if run_wise else "in time"}', columns, scale)


def _beginnings(view: StopView) -> np.ndarray:
    """Stops, in order of time, at which a jump is tried."""
    order = np.argsort(view.time, kind='stable')
    return at_most(order)


def _after(view: StopView, stop: int) -> np.ndarray:
    """The stops of a setup from one of them on."""
    return np.flatnonzero((view.setup == view.setup[stop]) & (view.time >= view.time[stop]))


def _jumps(view: StopView) -> Iterator[Form]:
    """One stop off, or a spot that jumps and stays for the rest of the setup."""
    order = _beginnings(view)

    def standing(at: np.ndarray) -> Made:
        return Made((1, len(view.time)), _standing, len(view.time), at)

    for name, columns, scale in _channels(view):
        for i in order:
            yield replace(pattern_form(view, f'{name}: one stop, {view.run_ids[view.run[i]]} stop {view.index[i]}',
                                       standing(np.array([i])), columns, scale), of_one_arrival=True)
        if name == 'displacement':
            continue
        for i in order:
            yield pattern_form(view, f'{name}: jump at {view.run_ids[view.run[i]]} stop {view.index[i]}',
                               standing(_after(view, i)), columns, scale)


def lasting_jumps(view: StopView, what: str, derivative: np.ndarray, scale: float) -> Iterator[Form]:
    """What acts by a ``derivative`` (k, n, c) jumps and stays for the rest of the setup."""
    for i in _beginnings(view):
        after = _after(view, i)
        columns = Made(derivative.shape, _times, derivative, after)
        yield Form(f'{what}: jump at {view.run_ids[view.run[i]]} stop {view.index[i]}', columns,
                   tuple(str(k) for k in range(len(columns))), np.full(len(columns), scale),
                   of_one_arrival=len(after) == 1)


def _stretched(distance: np.ndarray, shape: tuple[int, int], at: np.ndarray) -> np.ndarray:
    """The distance (n, beams) on the lengths at the stops ``at``, else nothing: (1, n, c) of ``shape`` (n, c)."""
    column = np.zeros((1, *shape))
    column[0, at, :distance.shape[1]] = distance[at]
    return column


def _lengths(view: StopView) -> Iterator[Form]:
    """The unit of length changes: at once from one stop on, or for one stretch of the log."""
    b = view.beams
    ordered = np.argsort(view.time, kind='stable')
    begins = [place for place in range(1, len(ordered))
              if view.run[ordered[place]] != view.run[ordered[place - 1]] or not place % 4]
    for place in at_most(begins):
        i = ordered[place]
        yield Form(f'length: another unit from {view.run_ids[view.run[i]]} stop {view.index[i]} on',
                   Made((1, *view.reading.shape), _stretched, view.distance, view.reading.shape, ordered[place:]),
                   ('0',), np.full(1, 1e-6))
    runs = np.unique(view.run)
    columns = view.zeros(len(runs))
    for k, run in enumerate(runs):
        columns[k, :, :b] = np.where((view.run == run)[:, None], view.distance, 0.0)
    yield Form('length: another unit in each run', columns, tuple(str(r) for r in runs),
               np.full(len(runs), 3e-7))


def _between_channels(view: StopView) -> Iterator[Form]:
    """One channel shows in another: spot in displacement, distance in spot, linear or squared."""
    b, spot = view.beams, view.model[:, view.beams:]
    centred = spot - spot.mean(axis=0)
    size = max(float(np.abs(centred).max()), 1e-9)
    x, y = (centred / size).T
    far = view.distance[:, 0] - view.distance[:, 0].mean()
    far = far / max(float(np.abs(far).max()), 1e-9)
    rate = np.where(view.axis < 3, 1.0, 0.0)
    sources = {'spot': np.stack([x, y]), 'spot, squared': np.stack([x, y, x * x, x * y, y * y]),
               'distance, squared': np.stack([far**2]), 'distance, cubed': np.stack([far**2, far**3]),
               'axis that moved': np.stack([rate * (view.axis == a) for a in range(3)])}
    for name, columns, scale in _channels(view):
        for source, patterns in sources.items():
            yield pattern_form(view, f'{name}: follows {source}', patterns, columns, scale)
    for source, patterns in sources.items():
        if not source.startswith('spot'):
            full = view.zeros(2 * len(patterns))
            full[:len(patterns), :, b] = full[len(patterns):, :, b + 1] = patterns
            yield numbered_form(f'spot: follows {source}', full, 3e-6)


def _put_inside(shape: tuple[int, int], sign: np.ndarray, pattern: np.ndarray, columns: slice) -> np.ndarray:
    """Patterns (k, b) times the dwells' signs (n,) in some of the c channels of ``shape`` (n, c): (k, n, b, c)."""
    inside = np.zeros((len(pattern), shape[0], pattern.shape[1], shape[1]))
    inside[..., columns] = (sign[None, :, None] * pattern[:, None, :])[..., None]
    return inside


def _inside(view: StopView) -> Iterator[Form]:
    """Something happens inside the dwells: alike in all, by direction, by axis, or setup by setup."""
    n, b = view.bin_time.shape
    pattern = np.eye(b) - 1.0 / b
    signs = {'alike': np.ones(n), 'by direction': view.direction.astype(float)}
    for axis, letter in enumerate('XYZ'):
        signs[f'after moves of {letter}'] = (view.axis == axis) * view.approach[:, axis]
    for name, columns, scale in _channels(view):
        for what, sign in signs.items():
            inside = Made((b, n, b, view.reading.shape[1]), _put_inside, view.reading.shape, sign, pattern, columns)
            yield Form(f'{name}: inside the dwells, {what}', view.zeros(b),
                       tuple(str(i) for i in range(b)), np.full(b, scale), inside=inside)
        setups = np.unique(view.setup)
        on = view.zeros(1)
        on[0, :, columns] = 1.0
        slopes = Product((view.setup == setups[:, None]).astype(float), on, view.off_middle)
        yield Form(f'{name}: inside the dwells, another slope in each setup', view.zeros(len(setups)),
                   tuple(view.setup_names[k] for k in setups),
                   np.full(len(setups), scale / max(float(np.ptp(view.off_middle)), 1e-9)), 'm/s', slopes)


def inconsistent_forms(view: StopView, forms: list[Form]) -> Iterator[Form]:
    """A named effect whose size is not the same everywhere: by setup, repeat, direction or half of the log.

    A cause has one size in a log; what takes its name but differs from setup to setup is something else.
    """
    splits = {'setup': view.setup, 'repeat': view.repeat, 'direction': view.direction,
              'half of the log': (view.time > np.median(view.time)).astype(int)}
    for form in forms:
        if len(form.columns) > 6:
            continue
        for what, groups in splits.items():
            values = np.unique(groups)
            masks = [groups == value for value in values if (groups == value).sum() >= 8]
            # What lives in one group alone, a slip in its run, cannot differ from group to group.
            masks = [mask for mask in masks if np.any(form.columns[:, mask])
                     or (form.inside is not None and np.any(form.inside[:, mask]))]
            if len(masks) < 2:
                continue
            columns = np.concatenate([form.columns * mask[None, :, None] for mask in masks[1:]])
            inside = None if form.inside is None else np.concatenate(
                [form.inside * mask[None, :, None, None] for mask in masks[1:]])
            yield Form(f'{form.label}: not alike from {what} to {what}', columns,
                       tuple(str(i) for i in range(len(columns))),
                       np.tile(form.scale, len(masks) - 1), form.units, inside)
