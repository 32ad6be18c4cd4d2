"""Angles of a regulated beam from ``psd/beam_angle``."""

import numpy as np

from stepdiag_ros.bag.blocks import backwards, order_of, stamps_ns, strangers, text
from stepdiag_ros.bag.tables import TopicTable
from stepdiag_ros.guard import limits
from stepdiag_ros.model.log import Samples


def beam_angles(table: TopicTable | None, setup_names: tuple[str, ...]) -> tuple[Samples, list[str]]:
    """Azimuth and elevation [rad] in order of time; those that are no angles or of no setup are left out."""
    if table is None:
        return Samples.empty(2), []
    malformed = [f'{table.topic}: left out {table.malformed} message(s) that do not hold their type'] \
        if table.malformed else []
    if not table.groups:
        return Samples.empty(2), malformed
    stamp, number, sequence = (np.concatenate(parts) for parts in zip(*(
        (stamps_ns(group.values), group.number, group.sequence) for group in table.groups), strict=True))
    warnings = malformed + backwards(stamp, number, table.topic)
    order = order_of(stamp, sequence, number)
    values = np.stack([np.concatenate([group.values[path] for group in table.groups])
                       for path in ('vector.x', 'vector.y')], axis=1)[order].astype(float)
    names, inverse = text(np.concatenate([group.values['header.frame_id'] for group in table.groups])[order])
    setup = np.array([setup_names.index(n) if n in setup_names else -1 for n in names], np.intp)[inverse]
    good = (np.abs(values) <= limits.BEAM_ANGLE_RAD).all(axis=1)
    if not good.all():
        warnings.append(f'{table.topic}: left out {int((~good).sum())} angle(s) that are NaN, infinite or beyond '
                        f'{limits.BEAM_ANGLE_RAD:g} rad')
    for rows, which in strangers(names, inverse, setup_names):
        warnings.append(f'{table.topic}: left out {int(rows.sum())} angle(s) of unknown setup {which}')
        good &= ~rows
    count = int(good.sum())
    return Samples(stamp[order][good], values[good], np.ones(count), np.ones(count), setup_names, setup[good],
                   np.arange(count)), warnings
