"""What is in a bag and what is missing, as plain values: the content of ``stepdiag info``."""

from pathlib import Path
from typing import Any

import numpy as np

from stepdiag_ros.bag.check import dwell_spans, lost_messages, samples_in_dwells, traverses
from stepdiag_ros.bag.reader import build_log, namespaces
from stepdiag_ros.bag.schemas import OCCASIONAL, TOPICS, split_topic
from stepdiag_ros.bag.source import open_bag
from stepdiag_ros.bag.tables import Tables, collect
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.model.log import CalibrationLog

_SECOND = 1e9


def summarise(path: str | Path, namespace: str | None = None) -> dict[str, Any]:
    """Everything that ``info`` shows, ready for JSON; damage is reported, not raised.

    Raises :class:`StepdiagError` only where there is no bag at all.
    """
    source = open_bag(path)
    tables = collect(source, lambda topic: split_topic(topic) is not None, tolerant=True)
    damage = list(tables.warnings)
    found = namespaces(tables)
    if namespace is not None:
        found = [name for name in found if name.strip('/') == namespace.strip('/')]
        if not found:
            raise StepdiagError(f'{path}: has no machine {namespace}; it holds '
                                f'{", ".join(namespaces(tables)) or "none"}')
    starts = [t.min() for table in tables.topics.values() for t in table.log_times if len(t)]
    ends = [t.max() for table in tables.topics.values() for t in table.log_times if len(t)]
    start, end = (int(min(starts)), int(max(ends))) if starts else (0, 0)
    return {
        'path': str(source.path), 'files': [f.name for f in source.files], 'bytes': tables.bytes,
        'start_ns': start, 'duration_s': (end - start) / _SECOND,
        'messages': sum(table.count for table in tables.topics.values()),
        'crc': tables.checked, 'damage': damage, 'directory': list(source.warnings),
        'topics': [_topic(tables, name) for name in sorted(tables.topics)],
        'machines': [_machine(source, tables, name) for name in found],
    }


def _topic(tables: Tables, name: str) -> dict[str, Any]:
    table = tables.topics[name]
    times = np.concatenate(table.log_times) if table.log_times else np.zeros(0, np.int64)
    span = int(times.max() - times.min()) / _SECOND if len(times) > 1 else 0.0
    return {'name': name, 'type': table.type, 'messages': table.count,
            'rate_hz': (table.count - 1) / span if span > 0 else None,
            'lost': lost_messages(table)}


def _machine(source, tables: Tables, name: str) -> dict[str, Any]:
    there = {split[1] for t, table in tables.topics.items()
             if (split := split_topic(t)) is not None and split[0] == name and table.count}
    absent = [topic for topic in TOPICS if topic not in there and topic not in OCCASIONAL]
    result: dict[str, Any] = {'namespace': name, 'absent_topics': absent}
    try:
        log = build_log(source, tables, name)
    except StepdiagError as error:
        return result | {'problem': str(error)}
    return result | _contents(log)


def _contents(log: CalibrationLog) -> dict[str, Any]:
    d = log.description
    spans, counts = dwell_spans(log.steps), samples_in_dwells(log.steps, log.displacement)
    rates = {}
    for key, samples in (('displacement', log.displacement), ('spot', log.spot)):
        inside = np.diff(samples.time_ns)[np.diff(samples.block) == 0]
        rates[key] = {'samples': len(samples), 'blocks': len(np.unique(samples.block)),
                      'sample_rate_hz': float(_SECOND / np.median(inside)) if len(inside) else None}
    return {
        'machine': {'name': d.machine.name, 'chain': d.machine.chain, 'volume_m': list(d.machine.volume),
                    'tool_m': list(d.machine.tool)},
        'plan': {'steps': d.plan.steps, 'order': d.plan.order, 'repeats': d.plan.repeats},
        'setups': list(d.setups), 'samples': rates,
        'environment': {key: {'values': len(s.value), 'mean': float(s.value.mean()),
                              'min': float(s.value.min()), 'max': float(s.value.max())}
                        for key, s in log.environment.items() if len(s.value)},
        'dwells': {'count': len(spans), 'without_samples': int((counts == 0).sum()),
                   'samples_least': int(counts.min()) if len(counts) else 0,
                   'samples_median': float(np.median(counts)) if len(counts) else 0.0},
        'runs': [{'run_id': t.run_id, 'setup': t.setup, 'repeat': t.repeat, 'direction': t.direction,
                  'stops_planned': t.planned, 'stops_seen': len(t.seen), 'missing': list(t.missing),
                  'double': list(t.double)} for t in traverses(d, log.steps)],
        'warnings': list(log.warnings),
    }
