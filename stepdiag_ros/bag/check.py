"""Is the log whole?  Lost messages, stops planned and seen, dwells and their samples."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.bag.cdr import alike
from stepdiag_ros.bag.schemas import OF_SEVERAL, split_topic
from stepdiag_ros.bag.tables import TopicTable
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import DONE, DWELL, Samples, StepEvents
from stepdiag_ros.model.path import stops


def lost_messages(table: TopicTable) -> int | None:
    """Messages missing between the first and the last, by sequence number.

    ``None`` where the writer set no numbers (all alike).  A fall is a publisher
    that began anew, not a loss; a number seen twice is not one either.  Several publishers are told apart by their
    ``frame_id``.
    """
    if not table.sequences:
        return None
    sequence = np.concatenate(table.sequences).astype(np.int64)
    if len(sequence) < 2 or (sequence == sequence[0]).all():
        return None
    return sum(int(np.maximum(np.diff(own) - 1, 0).sum()) for own in _by_publisher(table, sequence))


def _by_publisher(table: TopicTable, sequence: np.ndarray) -> list[np.ndarray]:
    """The numbers that each publisher gave, in the order of the log."""
    if (split_topic(table.topic) or ('', ''))[1] not in OF_SEVERAL or not table.groups:
        return [sequence]
    number, sequence, names = (np.concatenate(parts) for parts in zip(*(
        (group.number, group.sequence, group.values['header.frame_id']) for group in table.groups), strict=True))
    order = np.argsort(number)
    return [sequence[order][names[order] == name] for name in np.unique(names)]


def planned_stops(description: Description, setup: str) -> int:
    """Stops of one traverse: 3N + 1 on a step diagonal, a linear setup's own number."""
    return len(stops(description, setup))


@dataclass(frozen=True)
class Traverse:
    """One run in one direction and repeat, as seen: ``dwells`` by stop, ``missing`` stops."""

    run_id: str
    setup: str
    repeat: int
    direction: int
    planned: int
    seen: tuple[int, ...]
    missing: tuple[int, ...]
    double: tuple[int, ...]
    outside: tuple[int, ...]


def traverses(description: Description, steps: StepEvents) -> list[Traverse]:
    """Every traverse of the log in order of its first event."""
    keys = np.stack([steps.run, steps.setup, steps.repeat, steps.direction], axis=1) \
        if len(steps) else np.zeros((0, 4), np.int64)
    unique, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    found = []
    members = dict(alike(inverse.ravel()))
    for k in np.argsort(first, kind='stable'):
        run, setup, repeat, direction = (int(v) for v in unique[k])
        name = steps.setup_names[setup]
        planned = planned_stops(description, name)
        mine = members[int(k)]
        seen, counts = np.unique(steps.index[mine[steps.phase[mine] == DWELL]], return_counts=True)
        inside = seen < planned
        found.append(Traverse(
            steps.run_ids[run], name, repeat, direction, planned,
            tuple(int(i) for i in seen[inside]),
            tuple(int(i) for i in np.setdiff1d(np.arange(planned), seen)),
            tuple(int(i) for i in seen[counts > 1]), tuple(int(i) for i in seen[~inside])))
    return found


def dwell_spans(steps: StepEvents) -> np.ndarray:
    """Rows (m, 3): event number of each dwell, its begin and end [ns].

    A dwell ends with ``DONE`` or, where that is missing, with the next event.
    """
    begin = np.flatnonzero(steps.phase == DWELL)
    if not len(begin):
        return np.zeros((0, 3), np.int64)
    end_event = np.minimum(begin + 1, len(steps) - 1)
    end = steps.time_ns[end_event].copy()
    end[begin == len(steps) - 1] = np.iinfo(np.int64).max
    return np.stack([begin, steps.time_ns[begin], end], axis=1)


def samples_in_dwells(steps: StepEvents, samples: Samples, counted: np.ndarray | None = None) -> np.ndarray:
    """Samples of the dwell's own setup within each dwell, (m,); of those that are ``counted`` (n,), else of all."""
    spans = dwell_spans(steps)
    begin = np.searchsorted(samples.time_ns, spans[:, 1])
    end = np.searchsorted(samples.time_ns, spans[:, 2])
    setup = steps.setup[spans[:, 0]]
    of = samples.setup if counted is None else np.where(counted, samples.setup, -1)
    return np.array([np.count_nonzero(of[a:b] == s)
                     for a, b, s in zip(begin, end, setup, strict=True)], np.int64)


def listed(numbers: Sequence[object], most: int = 6) -> str:
    """``1, 2, 3`` with the tail cut."""
    shown = ', '.join(str(n) for n in numbers[:most])
    return shown + (f' and {len(numbers) - most} more' if len(numbers) > most else '')


def _looks(description: Description, setup: str) -> bool:
    """Whether a detector looks in a setup; one that is not described may have one."""
    return setup not in description.setups or description.setups[setup].sees_spot


def stop_warnings(description: Description, steps: StepEvents, displacement: Samples,
                  spot: Samples) -> list[str]:
    """What of the plan is missing, doubled or empty, a line each."""
    warnings = []
    found = traverses(description, steps)
    for t in found:
        where = f'run {t.run_id} ({t.setup}, repeat {t.repeat}, direction {t.direction:+d})'
        if t.missing:
            warnings.append(f'{where}: {len(t.missing)} of {t.planned} stops missing: '
                            f'{listed(t.missing)}')
        if t.double:
            warnings.append(f'{where}: stop(s) {listed(t.double)} visited more than once')
        if t.outside:
            warnings.append(f'{where}: stop(s) {listed(t.outside)} beyond the '
                            f'{t.planned} of the plan')
    for name in description.setups:
        repeats = {t.repeat for t in found if t.setup == name}
        if not repeats:
            warnings.append(f'setup {name} is described but has no run')
        elif len(repeats) < description.repeats_of(name):
            warnings.append(f'setup {name}: {len(repeats)} of {description.repeats_of(name)} '
                            'planned repeats are there')
    ends = int((steps.phase == DONE).sum())
    begins = int((steps.phase == DWELL).sum())
    if begins != ends:
        warnings.append(f'{begins} dwells began and {ends} ended; '
                        'a dwell without an end lasts to the next event')
    for samples, label in ((displacement, 'displacement'), (spot, 'spot')):
        if len(samples):
            counts = samples_in_dwells(steps, samples)
            nothing = counts == 0
            if samples is spot:
                looked = np.array([_looks(description, name) for name in steps.setup_names], bool)
                nothing &= looked[steps.setup[dwell_spans(steps)[:, 0]]]
            empty = int(nothing.sum())
            if empty:
                spans = dwell_spans(steps)[nothing, 0]
                places = [f'{steps.run_ids[steps.run[e]]} stop {steps.index[e]}' for e in spans]
                warnings.append(f'{empty} of {len(counts)} dwells hold no {label} sample: '
                                f'{listed(places, 3)}')
    # Between the dwells a beam may be gone, as where a mirror is swung: nothing is measured there.
    unlit = displacement.health == 0
    dark = samples_in_dwells(steps, displacement, unlit).sum() if unlit.any() else 0
    if dark:
        counted = samples_in_dwells(steps, displacement).sum()
        warnings.append(f'interferometer/displacement: {dark} of {counted} samples in the dwells have '
                        'signal quality 0; the evaluation leaves them out')
    return warnings
