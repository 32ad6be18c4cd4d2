"""A calibration log from a bag: :func:`read_log`.

Reads what the wire contract fixes and nothing else; knows no ROS.  Damage stops
the reading with one line and the remedy; what a lab can get wrong in a sound file
is left out and kept in ``CalibrationLog.warnings``.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from stepdiag_ros.bag.beamangles import beam_angles
from stepdiag_ros.bag.blocks import (
    backwards,
    displacement_samples,
    order_of,
    spot_samples,
    stamps_ns,
    strangers,
    text,
)
from stepdiag_ros.bag.check import lost_messages, stop_warnings
from stepdiag_ros.bag.clockoffsets import ClockOffsets, offsets_of, put_on_one_clock
from stepdiag_ros.bag.clocksteps import put_right
from stepdiag_ros.bag.schemas import (
    BEAM_ANGLE,
    DESCRIPTION,
    DISPLACEMENT,
    DISPLACEMENT_TIMING,
    SCALAR_FIELD,
    SCALE,
    SPOT,
    SPOT_TIMING,
    STEP,
    STEP_TIMING,
    TOPICS,
    WORKPIECE,
    split_topic,
)
from stepdiag_ros.bag.source import BagSource, open_bag
from stepdiag_ros.bag.tables import Tables, TopicTable, collect
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import CalibrationLog, Samples, ScalarSeries, StepEvents
from stepdiag_ros.model.path import stops

_MAIN = (DESCRIPTION, STEP, DISPLACEMENT)


def read_log(path: str | Path, namespace: str | None = None,
             description: Description | None = None) -> CalibrationLog:
    """Read the log of one machine from a rosbag2 directory or a bare ``.mcap``.

    ``namespace`` chooses the machine where a bag holds several; ``description``
    stands in for a bag's own.  Raises :class:`StepdiagError`.
    """
    source = open_bag(path)
    wanted = None if namespace is None else '/' + namespace.strip('/') if namespace.strip('/') else ''
    tables = collect(source, lambda topic: _wanted(topic, wanted))
    return build_log(source, tables, namespace, description)


def _wanted(topic: str, namespace: str | None) -> bool:
    split = split_topic(topic)
    return split is not None and (namespace is None or split[0] == namespace
                                  or split[0] == namespace.lstrip('/'))


def namespaces(tables: Tables) -> list[str]:
    """Machines of a bag: namespaces with a description, steps or displacements."""
    found = []
    for topic in tables.topics:
        split = split_topic(topic)
        if split is not None and split[1] in _MAIN and split[0] not in found:
            found.append(split[0])
    return found


def choose(tables: Tables, namespace: str | None, path: Path) -> str:
    """The namespace to read; :class:`StepdiagError` names the choices."""
    found = namespaces(tables)
    listing = ', '.join(n or '(none)' for n in found)
    if namespace is None:
        if not found:
            topics = ', '.join(sorted(tables.topics)[:4]) or 'no topic at all'
            raise StepdiagError(f'{path}: holds no topic of a calibration log (it holds {topics}); '
                                f'wanted are {", ".join(_MAIN)} below a machine namespace')
        if len(found) > 1:
            raise StepdiagError(f'{path}: holds the machines {listing}; choose one with --namespace')
        return found[0]
    for name in found:
        if name.strip('/') == namespace.strip('/'):
            return name
    raise StepdiagError(f'{path}: has no machine {namespace}; it holds {listing or "none"}')


def build_log(source: BagSource, tables: Tables, namespace: str | None = None,
              description: Description | None = None) -> CalibrationLog:
    """The log of one machine from tables already read."""
    name = choose(tables, namespace, source.path)
    mine = {relative: tables.topics.get(f'{name}/{relative}' if name else relative)
            or tables.topics.get(f'/{relative}' if not name else f'{name}/{relative}')
            for relative in TOPICS}
    measured = offsets_of(mine)
    warnings = [*source.warnings, *tables.warnings, *_wrong_counts(source, tables), *_notes(source),
                *put_right(mine)]
    if not tables.checked:
        warnings.append('the file carries no CRCs: a changed byte in it would not be noticed')
    if description is None:
        description = _description(source.path, name, mine[DESCRIPTION])
    tables_of: dict[str, TopicTable] = {}
    for relative in (STEP, DISPLACEMENT):
        table = mine[relative]
        if table is None or not table.count:
            raise StepdiagError(f'{source.path}: topic {name}/{relative} '
                                f'({TOPICS[relative]}) is missing or has no message; '
                                'without it nothing can be evaluated')
        tables_of[relative] = table
    setup_names = tuple(description.setups)
    steps, notes = _steps(tables_of[STEP], description)
    warnings += notes
    warnings += _repeated(steps.run_ids)
    offsets = {sensor: clock.until(int(steps.time_ns[-1])) for sensor, clock in measured.items()} if len(steps) else {}
    warnings += put_on_one_clock(mine, offsets)
    displacement, notes = displacement_samples(tables_of[DISPLACEMENT], setup_names, mine[DISPLACEMENT_TIMING])
    warnings += notes
    for found, relative in ((steps, STEP), (displacement, DISPLACEMENT)):
        if not len(found):
            raise StepdiagError(f'{source.path}: topic {name}/{relative} holds nothing that can be '
                                f'used: {notes_of(warnings, relative)}')
    spot = Samples.empty(2)
    spots = mine[SPOT]
    if spots is None or not spots.count:
        warnings.append(f'{name}/{SPOT} is missing: no angle is measured, '
                        'the evaluation rests on distances alone')
    else:
        spot, notes = spot_samples(spots, setup_names, mine[SPOT_TIMING])
        warnings += notes
    angles, notes = beam_angles(mine[BEAM_ANGLE], setup_names)
    warnings += notes
    environment: dict[str, ScalarSeries] = {}
    for relative, table in mine.items():
        if table is not None and TOPICS[relative] in SCALAR_FIELD:
            series, notes = _scalars(relative, table)
            environment |= {key: one.during(int(steps.time_ns[0]), int(steps.time_ns[-1]))
                            for key, one in series.items()}
            warnings += notes
    for table in mine.values():
        if table is not None and (lost := lost_messages(table)):
            warnings.append(f'{table.topic}: {lost} message(s) were lost before the recorder '
                            '(gaps in the sequence numbers)')
    warnings += stop_warnings(description, steps, displacement, spot)
    displacement, spot = (_less_certain(samples, offsets.get(sensor))
                          for sensor, samples in (('interferometer', displacement), ('psd', spot)))
    return CalibrationLog(description, steps, displacement, spot, environment, str(source.path),
                          name, tuple(warnings), _clocks(mine), angles)


def _less_certain(samples: Samples, clock: ClockOffsets | None) -> Samples:
    """Samples that were put onto the sequencer's clock: to what is known of their times adds what is known of it."""
    known = samples.uncertainty_ns
    if clock is None or clock.one or known is None:
        return samples
    return replace(samples, uncertainty_ns=np.where(known >= 0, known + clock.uncertainty_at(samples.time_ns), known))


def _clocks(mine: dict[str, TopicTable | None]) -> dict[str, str]:
    """Names of the clocks that stamped; of a source that names several there is none."""
    clocks = {}
    for source, relative in (('sequencer', STEP_TIMING), ('interferometer', DISPLACEMENT_TIMING), ('psd', SPOT_TIMING)):
        table = mine[relative]
        names = {bytes(raw) for group in table.groups for raw in group.values['clock']} if table is not None else ()
        if len(names) == 1 and (clock := names.pop().decode('utf-8', 'replace')):
            clocks[source] = clock
    return clocks


def notes_of(warnings: list[str], relative: str) -> str:
    """Warnings about one topic in one line."""
    return '; '.join(w.split(': ', 1)[-1] for w in warnings if relative in w) or 'all blocks are empty'


def _notes(source: BagSource) -> list[str]:
    """What was reported when the bag was made of something else: whoever reads it should know."""
    custom = source.metadata.get('custom_data')
    if not isinstance(custom, dict):
        return []
    return [f'import: {text}' for key, text in custom.items() if 'imported_from' in custom and key.startswith('note_')]


def _repeated(run_ids: tuple[str, ...]) -> list[str]:
    """Runs that were broken off, by a node that died or an instrument that was lost, and repeated: ``ppp/0/+/2``."""
    return [f'run {run_id.rpartition("/")[0]} was broken off and repeated as {run_id}; complete stops of both count'
            for run_id in run_ids if run_id.count('/') == 3 and run_id.rpartition('/')[2].isdigit()]


def _wrong_counts(source: BagSource, tables: Tables) -> list[str]:
    if source.counts is None:
        return []
    warnings = []
    for topic in sorted(source.counts.keys() | tables.topics.keys()):
        said = source.counts.get(topic)
        held = tables.topics[topic].count if topic in tables.topics else 0
        if (said or 0) != held:
            warnings.append(f'metadata.yaml says {"nothing" if said is None else said} of the '
                            f'messages of {topic}, the bag holds {held}; believing the bag')
    return warnings


def _description(path: Path, name: str, table: TopicTable | None) -> Description:
    topic = f'{name}/{DESCRIPTION}'
    if table is None or not table.groups:
        raise StepdiagError(f'{path}: topic {topic} ({TOPICS[DESCRIPTION]}) is missing or has no '
                            'message; without the description of machine and setups nothing can be '
                            'evaluated')
    texts = {bytes(raw).decode('utf-8', 'replace') for g in table.groups for raw in g.values['data']}
    first, *others = sorted(texts)
    found = Description.from_yaml(first, f'{path}: {topic}')
    if len(texts) > limits.DESCRIPTIONS or \
            any(Description.from_yaml(other, f'{path}: {topic}') != found for other in others):
        raise StepdiagError(f'{path}: topic {topic} holds {len(texts)} descriptions that differ; '
                            'record each cell in a bag of its own')
    return found


def _stack(table: TopicTable, path: str) -> np.ndarray:
    return np.concatenate([group.values[path] for group in table.groups])


def _ordered(table: TopicTable) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Stamps (n,) in log order of groups, the order by (stamp, sequence), warnings."""
    stamp = np.concatenate([stamps_ns(group.values) for group in table.groups])
    number = np.concatenate([group.number for group in table.groups])
    sequence = np.concatenate([group.sequence for group in table.groups])
    warnings = backwards(stamp, number, table.topic)
    if table.malformed:
        warnings.append(f'{table.topic}: left out {table.malformed} message(s) '
                        'that do not hold their type')
    return stamp, order_of(stamp, sequence, number), warnings


def _steps(table: TopicTable, description: Description) -> tuple[StepEvents, list[str]]:
    """Events of ``sequencer/step`` in order; those that cannot be are left out."""
    setup_names = tuple(description.setups)
    if not table.groups:
        return _no_steps(setup_names), [f'{table.topic}: left out {table.malformed} message(s) '
                                        'that do not hold their type']
    stamp, order, warnings = _ordered(table)
    columns = {key: _stack(table, key)[order] for key in
               ('run_id', 'setup', 'repeat', 'direction', 'index', 'axis', 'phase')}
    stamp = stamp[order]
    commanded = np.stack([_stack(table, f'commanded.{c}') for c in 'xyz'], axis=1)[order].astype(float)
    names, inverse = text(columns['setup'])
    setup = np.array([setup_names.index(n) if n in setup_names else -1 for n in names], np.intp)[inverse]
    good = np.ones(len(stamp), bool)

    def drop(bad: np.ndarray, why: str) -> None:
        nonlocal good
        count = int((bad & good).sum())
        good &= ~bad
        if count:
            warnings.append(f'{table.topic}: left out {count} event(s) {why}')

    for rows, which in strangers(names, inverse, setup_names):
        drop(rows, f'of unknown setup {which} (the description has {", ".join(setup_names)})')
    drop(~np.isin(columns['phase'], (0, 1, 2)), 'whose phase is none of MOVE, DWELL, DONE')
    drop(~np.isin(columns['axis'], (0, 1, 2, 255)), 'whose axis is none of X, Y, Z, NONE')
    drop(~np.isin(columns['direction'], (-1, 1)), 'whose direction is neither +1 nor -1')
    same = np.zeros(len(stamp), bool)
    same[1:] = np.logical_and.reduce([c[1:] == c[:-1] for c in (stamp, *columns.values())])
    drop(same, 'that the log holds twice')
    planned = _by_plan(commanded, setup, columns['index'], description)
    drop(~np.isfinite(planned).all(axis=1), 'that carry no possible commanded position and no index of the plan')
    if odd := int((good & (planned != commanded).any(axis=1)).sum()):
        warnings.append(f'{table.topic}: {odd} event(s) carry a commanded position that is NaN, infinite or far away; '
                        "the plan's position stands")
    run_names, run = text(columns['run_id'])
    first = np.full(len(run_names), len(run), np.intp)
    np.minimum.at(first, run[good], np.flatnonzero(good))
    # Runs are numbered in the order in which they began.
    present = [int(k) for k in np.argsort(first, kind='stable') if first[k] < len(run)]
    renumber = np.full(len(run_names), -1, np.intp)
    renumber[present] = np.arange(len(present))
    numbers = {key: columns[key][good].astype(np.int64) for key in ('repeat', 'direction', 'index', 'axis', 'phase')}
    events = StepEvents(
        time_ns=stamp[good], run_ids=tuple(run_names[k] for k in present), run=renumber[run][good],
        setup_names=setup_names, setup=setup[good], commanded=planned[good], **numbers)
    if len(np.unique(np.stack([events.run, events.setup, events.repeat, events.direction]), axis=1).T) > limits.RUNS:
        raise StepdiagError(f'{table.topic}: holds more than {limits.RUNS} traverses; no calibration has so many')
    return events, warnings


def _by_plan(commanded: np.ndarray, setup: np.ndarray, index: np.ndarray, description: Description) -> np.ndarray:
    """Positions (m, 3) [m], the plan's where one cannot be; NaN where the plan has none for setup and index either."""
    far = ~(np.abs(commanded) <= limits.LENGTH_M).all(axis=1)
    mended = np.where(far[:, None], np.nan, commanded)
    for number in np.unique(setup[far & (setup >= 0)]):
        positions = stops(description, tuple(description.setups)[number]).positions
        rows = np.flatnonzero(far & (setup == number) & (index >= 0) & (index < len(positions)))
        mended[rows] = positions[index[rows]]
    return mended


def _no_steps(setup_names: tuple[str, ...]) -> StepEvents:
    none = np.zeros(0, np.int64)
    return StepEvents(none, (), none, setup_names, none, none, none, none, none,
                      np.zeros((0, 3)), none)


def _scalars(relative: str, table: TopicTable) -> tuple[dict[str, ScalarSeries], list[str]]:
    """Series of one environment topic; the scales' temperatures are split by axis."""
    if not table.groups:
        return {}, []
    stamp, order, warnings = _ordered(table)
    value = _stack(table, SCALAR_FIELD[TOPICS[relative]])[order].astype(float)
    variance = _stack(table, 'variance')[order].astype(float)
    stamp = stamp[order]
    low, high = limits.ENVIRONMENT[relative.split('/')[-1]]
    good = (value >= low) & (value <= high)
    variance = np.where(variance >= 0.0, np.minimum(variance, 1.0e12), 0.0)
    if not good.all():
        warnings.append(f'{table.topic}: left out {int((~good).sum())} value(s) that are NaN, infinite or beyond '
                        f'{low:g} to {high:g}; check the unit (°C, Pa, 0 to 1)')
    if relative != SCALE:
        key = relative.split('/')[-1]
        return ({key: ScalarSeries(stamp[good], value[good], variance[good])} if good.any() else {}), warnings
    names, inverse = text(_stack(table, 'header.frame_id')[order])
    series = {}
    warnings += [f'{table.topic}: left out {int(rows.sum())} value(s) of frame_id {which}; it must be x, y or z, or '
                 f'{WORKPIECE}'
                 for rows, which in strangers(names, inverse, ('x', 'y', 'z', 'X', 'Y', 'Z', WORKPIECE))]
    for position, name in enumerate(names):
        if name.lower() not in ('x', 'y', 'z', WORKPIECE):
            continue
        rows = good & (inverse == position)
        if rows.any():
            series[f'scale_temperature/{name.lower()}'] = ScalarSeries(stamp[rows], value[rows],
                                                                       variance[rows])
    return series, warnings
