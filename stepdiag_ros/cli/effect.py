"""Whether an effect of your own is sound: how it acts and how it appears say the same.

Runs the code in FILE.py, so give only files that you trust.  Draws plausible parameters, simulates a small cell with
and without the effect, fits what changed with the effect's own forms (how much they leave, how large they estimate it),
names the effects of the vocabulary with which it can be confounded, and diagnoses its log.

Exit status 0: sound; 1: the two do not agree; 2: the file cannot be used, one line says why.

  stepdiag effect check spindle_growth.py
  stepdiag effect check spindle_growth.py --seed 2 --json
"""

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING

from stepdiag_ros.guard.jsontext import to_json

if TYPE_CHECKING:
    from stepdiag_ros.twin.effect_check import Checked

NAME = 'effect'
HELP = 'check an effect of your own: simulate it, find it, say with what it is confounded'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('action', choices=['check'], help='what to do')
    parser.add_argument('file', metavar='FILE.py', help='Python file with the effect; it is run')
    parser.add_argument('--seed', type=int, default=1, help='draws other parameters (default: 1)')
    parser.add_argument('--json', action='store_true', help='print what came of it as JSON')


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.effects import all_effects, effects_in_file
    from stepdiag_ros.errors import StepdiagError
    from stepdiag_ros.twin.effect_check import check_effect

    if args.seed < 0:
        raise StepdiagError(f'--seed is {args.seed}; give 0 or more')
    if not args.json:
        print(f'{args.file}: its code is run ...', flush=True)
    all_effects([args.file])    # names that are taken are reported before the work begins
    results = [check_effect(kind, args.seed) for kind in effects_in_file(args.file)]
    if args.json:
        print(to_json({'file': args.file, 'effects': [asdict(result) | {'passed': not result.problems}
                                                      for result in results]}))
    else:
        print('\n'.join(_words(result) for result in results))
    return 1 if any(result.problems for result in results) else 0


def _words(result: 'Checked') -> str:
    tried = ', '.join(f'{name} {_plain(value)}' for name, value in result.parameters.items())
    lines = [f'{result.name}: {"NOT PASSED" if result.problems else "passed"}',
             f'  tried with {tried}; it changes the log by {result.sigma:.3g} σ']
    if result.form:
        lines.append(f'  its nearest form ({result.form}) leaves {100 * result.left:.2g} % of that')
        lines.append('  size not compared: no parameter has the unit and number of the coefficients'
                     if result.ratio is None else
                     f'  estimated size over the given one: {result.ratio:.3f} ± {result.ratio_sigma:.3f} (k = 1)')
        lines.append('  confounded with: ' + (', '.join(f'{name} (leaves {left:.1f} σ)' for name, left
                                                        in result.confounded.items()) or 'nothing in the vocabulary'))
        lines.append('  diagnosis of its log: ' + ', '.join(f'{name} {p:.2f}' for name, p in sorted(
            result.named.items(), key=lambda pair: -pair[1])))
    return '\n'.join([*lines, *(f'  wrong: {problem}' for problem in result.problems)])


def _plain(value: object) -> str:
    return '[' + ', '.join(_plain(v) for v in value) + ']' if isinstance(value, list) else \
        f'{value:.3g}' if isinstance(value, float) else str(value)
