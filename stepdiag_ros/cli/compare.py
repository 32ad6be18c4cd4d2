"""Evaluate a log with every method that fits it, side by side.

Prints for each method how far its errors lie from the truth (--truth), or, where
there is none, from the enhanced method's answer.  Methods that the log cannot serve
are named with what they would need.

  stepdiag compare bags/demo
  stepdiag compare shared/log_05 --truth truth.json --out compare.png
"""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stepdiag_ros.cli.evaluate import tied_lines
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.cautions import cautions
from stepdiag_ros.estimate.compare import Comparison, compare, text_table, truth_of
from stepdiag_ros.estimate.evaluate import evaluate_in_full
from stepdiag_ros.estimate.method_budget import Readings
from stepdiag_ros.estimate.methods import METHODS, run_all
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.guard import limits
from stepdiag_ros.guard.files import read_text, real
from stepdiag_ros.guard.jsontext import to_json

NAME = 'compare'
HELP = 'evaluate a log with every method that fits it, side by side'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', metavar='BAG', help='rosbag2 folder or .mcap file')
    parser.add_argument('--truth', metavar='FILE', type=Path,
                        help='known errors (JSON): a truth.json, or the output of evaluate --json')
    parser.add_argument('--out', metavar='FILE', type=Path,
                        help='draw the curves of all methods into this file (.png, .svg, .pdf)')
    parser.add_argument('--json', action='store_true', help='print everything as JSON')
    parser.add_argument('--namespace', help="the machine's namespace where a log holds several")


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.bag.reader import read_log

    # What is wrong with the words of the command is said before a minute is spent on the log.
    if args.out is not None and not args.out.absolute().parent.is_dir():
        raise StepdiagError(f'{args.out}: the picture cannot be written: there is no folder {args.out.parent}')
    known = None if args.truth is None else read_text(args.truth, limits.TEXT_BYTES, 'file of known errors')
    log = read_log(args.bag, args.namespace)
    readings = Readings.of(evaluate_in_full(log))
    results, skipped = run_all(log, readings)
    name = real(args.bag)
    name = name.stem if name.suffix == '.mcap' else name.name
    if known is not None:
        reference, label = truth_of(known, log.description, name, str(args.truth)), 'truth'
    else:
        best = results.get('enhanced')
        if not isinstance(best, Solution):
            raise StepdiagError(f'{args.bag}: no method gives errors to compare with; '
                                'give the known errors with --truth FILE')
        reference, label = best.errors, 'enhanced'
    outcome = compare(results, reference, label, log.description)
    best = results.get('enhanced')
    warned = cautions(readings.measured, best if isinstance(best, Solution) else None)
    if args.out is not None:
        from stepdiag_ros.report.compare_picture import draw

        solutions = {n: r for n, r in results.items() if isinstance(r, Solution)}
        draw(outcome, solutions, args.out, title=name)
    if args.json:
        print(to_json(_json(outcome, results, skipped) | {'cautions': list(warned)}))
    else:
        print(text_table(outcome))
        print()
        for line in _tied(results):
            print(line)
        for caution in warned:
            print(f'caution: {caution}')
        for method, result in results.items():
            for remark in getattr(result, 'remarks', ()):
                print(f'remark: {method}: {remark}')
        for method, why in skipped.items():
            print(f'not run: {method} ({METHODS[method].title}): {why}')
        if args.out is not None:
            print(f'picture: {args.out}')
    return 0


def _tied(results: Mapping[str, Any]) -> list[str]:
    """What all results rest on, for they have the lengths of one log: metre, 20 °C, budget."""
    result = next((r for r in results.values() if r.traceability is not None), None)
    if result is None:
        return []
    return [*tied_lines(result), *(f'warning: {remark}' for remark in result.traceability.remarks)]


def _json(outcome: Comparison, results: dict, skipped: dict[str, str]) -> dict:
    return {'reference': outcome.reference,
            'largest_deviation': {m: dict(d) for m, d in outcome.deviation.items()},
            'within_k2': dict(outcome.within_k2),
            'largest_sigma': {m: dict(s) for m, s in outcome.sigma.items()},
            'figures': {m: [{'name': n, 'measured_m': a, 'reference_m': b} for n, a, b in rows]
                        for m, rows in outcome.figures.items()},
            'results': {m: r.to_json_dict() for m, r in results.items()},
            'not_run': skipped}
