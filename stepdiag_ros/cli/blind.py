"""The blind check of the gap diagnosis.

`stepdiag blind seal` draws machines and hidden effects, writes their logs and locks the truth
away; `answer` diagnoses the logs without it; `open` checks that neither was touched since and
scores.
"""

import argparse
import sys
from pathlib import Path

from stepdiag_ros.guard.jsontext import to_json

NAME = 'blind'
HELP = 'seal, answer and open the blind check of the diagnosis'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    steps = parser.add_subparsers(dest='step', metavar='STEP', required=True)
    seal = steps.add_parser('seal', help='make the logs and lock their truth away')
    seal.add_argument('--seed', type=int, required=True, help='what everything is drawn from')
    seal.add_argument('--null', type=int, default=0, help='logs without an effect')
    seal.add_argument('--single', type=int, default=0, help='logs with one effect of the vocabulary')
    seal.add_argument('--pair', type=int, default=0, help='logs with two')
    seal.add_argument('--outside', type=int, default=0, help='logs with an effect from outside it')
    seal.add_argument('--unseen', type=int, default=0,
                      help='logs with an effect from outside, of kinds that the diagnosis has not met')
    seal.add_argument('--live', type=int, default=0,
                      help='logs without an effect that are measured through the running graph, every second one on a '
                           'busy computer (a minute or two each)')
    seal.add_argument('--untidy', type=float, default=0.0, metavar='SHARE',
                      help='share of the simulated worlds with untidy noise: heavy tails, correlation, steps, '
                           'dropouts, spikes, duplicates, late samples (0)')
    seal.add_argument('--wide', action='store_true',
                      help='more kinds of effects from outside, larger sizes, time profiles that begin with anything')
    seal.add_argument('--purpose', default='sealed',
                      help='sealed, or develop: to tune on, never the same logs (default: sealed)')
    seal.add_argument('--world', default='varied',
                      help='varied machines and plans, or field: the usual plan (default: varied)')
    seal.add_argument('--small', action='store_true', help='three steps an axis, for a quick look')
    seal.add_argument('--out', type=Path, required=True, help='folder of the set')
    answer = steps.add_parser('answer', help='diagnose the logs and lock the answers')
    answer.add_argument('folder', type=Path, help='folder of the set')
    opened = steps.add_parser('open', help='check the hashes and score')
    opened.add_argument('folder', type=Path, help='folder of the set')
    opened.add_argument('--floor', action='store_true',
                        help='measure first in the sealed worlds what noise alone leaves of each log (seconds a log)')
    opened.add_argument('--apart', action='store_true',
                        help='judge first which effects another could stand for (some seconds a log)')
    opened.add_argument('--settle', action='store_true',
                        help='first do the further run that an undecided answer recommends, in the sealed world')
    opened.add_argument('--json', action='store_true', help='print the score as JSON')
    opened.add_argument('--page', type=Path, help='Markdown page to put the results into, below its mark')
    for sub in (seal, answer, opened):
        sub.add_argument('--processes', type=int, default=2, help='logs worked on at a time (2)')
        sub.add_argument('--quiet', action='store_true', help='no progress')


def run(args: argparse.Namespace) -> int:
    return {'seal': _seal, 'answer': _answer, 'open': _open}[args.step](args)


def _seal(args: argparse.Namespace) -> int:
    from stepdiag_ros.blind.seal import orders, seal
    counts = {name: getattr(args, name) for name in ('null', 'single', 'pair', 'outside', 'unseen', 'live')}
    todo = orders(args.purpose, args.seed, counts, args.world, args.small, args.untidy, args.wide)
    digest = seal(args.out, todo, args.processes, not args.quiet)
    print(f'{len(todo)} logs in {args.out / "logs"}\ntruth sealed, SHA-256 {digest}')
    return 0


def _answer(args: argparse.Namespace) -> int:
    from stepdiag_ros.blind.answer import answer
    digest = answer(args.folder, args.processes, not args.quiet)
    print(f'answers in {args.folder / "answers"}\nlocked, SHA-256 {digest}')
    return 0


def _open(args: argparse.Namespace) -> int:
    from stepdiag_ros.blind.opened import into_page, open_set, table
    if args.floor or args.apart:
        from stepdiag_ros.blind.judge import judge_apart, judge_floors
        if args.floor:
            judge_floors(args.folder, args.processes, not args.quiet)
        if args.apart:
            judge_apart(args.folder, args.processes, not args.quiet)
    if args.settle:
        from stepdiag_ros.blind.settle import settle
        settle(args.folder, None if args.quiet else _tell, args.processes)
    result = open_set(args.folder)
    if args.page is not None:
        into_page(result, args.folder, args.page)
    print(to_json(result) if args.json else table(result))
    return 0


def _tell(row: dict) -> None:
    print(f'{row["log"]}: {" / ".join(row["between"])}: {"settled" if row["settled"] else "open"}', file=sys.stderr,
          flush=True)
