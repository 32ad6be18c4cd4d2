"""Mend a torn or damaged bag and say per topic what is lost.

Writes a new bag beside the damaged one, with indexes and metadata, and reads it
back with all checks on; the damaged one stays as it is.

  stepdiag recover bags/demo
  stepdiag recover log.mcap --to mended
"""

import argparse
import dataclasses

from stepdiag_ros.bag.recover import Recovery, recover
from stepdiag_ros.guard.jsontext import to_json

NAME = 'recover'
HELP = 'mend a torn bag and say what is lost'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', metavar='BAG', help='rosbag2 folder or .mcap file')
    parser.add_argument('--to', metavar='FOLDER', help='the new bag (default: BAG_recovered)')
    parser.add_argument('--json', action='store_true', help='print the report as JSON')


def run(args: argparse.Namespace) -> int:
    outcome = recover(args.bag, args.to)
    if args.json:
        print(to_json(dataclasses.asdict(outcome)))
    else:
        print(text(outcome))
    return 0


def text(outcome: Recovery) -> str:
    """The report for people."""
    lines = [f'{outcome.source}: {outcome.recovered:,} messages recovered into {outcome.target}']
    lines += [f'  damage: {fault}' for fault in outcome.faults]
    if not outcome.faults:
        lines.append('  no damage was found; the copy has fresh indexes and metadata')
    lines += [f'  left behind: {note}' for note in outcome.notes]
    width = max(len(t.topic) for t in outcome.topics)
    lines.append(f'  {"topic":{width}}  {"recovered":>9}  {"lost":>8}  lost before the recorder')
    for t in outcome.topics:
        lost = 'unknown' if t.lost is None else str(t.lost)
        gaps = 'unknown' if t.gaps is None else str(t.gaps)
        lines.append(f'  {t.topic:{width}}  {t.recovered:>9,}  {lost:>8}  {gaps}')
    if any(t.lost for t in outcome.topics) or outcome.faults:
        lines.append('  lost counts what the bag itself announces; messages that came in after its last '
                     'word are not in it')
    return '\n'.join(lines)
