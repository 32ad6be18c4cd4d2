"""What a bag holds and what is missing.

Lists the topics with counts and rates, the machine, the setups and every run with
its stops seen and planned, and says what is lost, left out or damaged.

  stepdiag info bags/demo
  stepdiag info log_05.mcap --json
"""

import argparse
import datetime
from typing import Any

from stepdiag_ros.bag.check import listed
from stepdiag_ros.bag.summary import summarise
from stepdiag_ros.guard.jsontext import to_json

NAME = 'info'
HELP = 'what a bag holds and what is missing'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', metavar='BAG', help='rosbag2 folder or .mcap file')
    parser.add_argument('--namespace', help="the machine's namespace where a log holds several")
    parser.add_argument('--json', action='store_true', help='print everything as JSON')


def run(args: argparse.Namespace) -> int:
    found = summarise(args.bag, args.namespace)
    print(to_json(found) if args.json else text(found))
    return 0


def text(found: dict[str, Any]) -> str:
    """The summary for people."""
    try:
        start = f'{datetime.datetime.fromtimestamp(found["start_ns"] / 1e9, datetime.UTC):%Y-%m-%d %H:%M:%S} UTC'
    except (ValueError, OverflowError, OSError):   # no calendar knows it
        start = f'{found["start_ns"]} ns since 1970'
    lines = [f'{found["path"]}: {", ".join(found["files"])}, {_size(found["bytes"])}',
             f'{found["messages"]:,} messages over {_duration(found["duration_s"])} '
             f'from {start}, '
             + ('CRCs checked' if found['crc'] else 'no CRCs: a changed byte would not be noticed'), '']
    width = max((len(t['name']) for t in found['topics']), default=5)
    kinds = max((len(t['type']) for t in found['topics']), default=4)
    lines.append(f'{"topic":{width}}  {"type":{kinds}}  {"messages":>9}  {"rate":>10}  lost')
    for t in found['topics']:
        rate = '' if t['rate_hz'] is None else f'{t["rate_hz"]:.4g} Hz'
        lost = 'unknown' if t['lost'] is None else str(t['lost'])
        lines.append(f'{t["name"]:{width}}  {t["type"]:{kinds}}  {t["messages"]:>9,}  {rate:>10}  {lost}')
    for machine in found['machines']:
        lines += ['', *_machine(machine)]
    if not found['machines']:
        lines += ['', 'No machine: no topic of a calibration log is in it.']
    problems = [*found['directory'], *(f'damaged: {d}' for d in found['damage'])]
    said = {w for m in found['machines'] for w in m.get('warnings', ())}
    problems = [p for p in problems if p not in said]
    if found['damage']:
        problems.append(f'mend it with: stepdiag recover {found["path"]}')
    return '\n'.join(lines + (['', *problems] if problems else []))


def _machine(m: dict[str, Any]) -> list[str]:
    title = f'machine {m["namespace"] or "(no namespace)"}'
    if 'problem' in m:
        return [f'{title}: cannot be evaluated', f'  {m["problem"]}',
                f'  topics not there: {", ".join(m["absent_topics"]) or "none"}']
    volume = ' × '.join(f'{v:g}' for v in m['machine']['volume_m'])
    lines = [f'{title}: {m["machine"]["name"]}, chain {m["machine"]["chain"]}, {volume} m; '
             f'{m["plan"]["steps"]} steps an axis in order {m["plan"]["order"]}, '
             f'{m["plan"]["repeats"]} repeat(s); setups {", ".join(m["setups"])}']
    for key, s in m['samples'].items():
        rate = f' at {s["sample_rate_hz"]:.4g} Hz' if s['sample_rate_hz'] else ''
        lines.append(f'  {key}: {s["samples"]:,} samples in {s["blocks"]:,} blocks{rate}')
    lines.append(f'  dwells: {m["dwells"]["count"]}, {m["dwells"]["samples_median"]:g} samples in the '
                 f'median one, {m["dwells"]["samples_least"]} in the least')
    for key, e in m['environment'].items():
        lines.append(f'  {key}: {e["values"]} values, {e["min"]:.6g} to {e["max"]:.6g}')
    lines.append(f'  {"run":14} {"setup":6} {"repeat":>6} {"dir":>4}  stops')
    for r in m['runs']:
        lines.append(f'  {r["run_id"]:14} {r["setup"]:6} {r["repeat"]:>6} {r["direction"]:>+4d}  '
                     f'{r["stops_seen"]} of {r["stops_planned"]}'
                     + (f', missing {listed(r["missing"])}' if r['missing'] else '')
                     + (f', double {listed(r["double"])}' if r['double'] else ''))
    if m['absent_topics']:
        lines.append(f'  not there: {", ".join(m["absent_topics"])}')
    return lines + [f'  warning: {w}' for w in m['warnings']]


def _size(count: int) -> str:
    for unit in ('B', 'kB', 'MB'):
        if count < 1000:
            return f'{count:.3g} {unit}'
        count /= 1000
    return f'{count:.3g} GB'


def _duration(seconds: float) -> str:
    minutes, rest = divmod(seconds, 60)
    hours, minutes = divmod(int(minutes), 60)
    return f'{hours} h {minutes} min' if hours else f'{minutes} min {rest:.0f} s' if minutes \
        else f'{rest:.3g} s'
