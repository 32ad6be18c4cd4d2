"""Decide by a log before and a log after whether a machine conforms to tolerances.

Shows the volumetric error, E and B of ISO 230-6 and the 21 errors before and after, each with U, decides by
ISO 14253-1 (conforms, does not conform, undecided), checks the measurement against the prediction that came with the
tables, and writes DIR/index.html and DIR/verify.json.

A tolerance is a length with its unit for the volumetric error, or NAME=VALUE for E, B or one of the 21 errors.
Exit status: 0 conforms, 1 does not conform, 4 undecided, 2 bad input, logs not corrected for air among them.

  stepdiag verify bags/before bags/after --tolerance 12um
  stepdiag verify bags/before bags/after --tolerance 12um E=8um EC0Y=15urad --prediction tables/prediction.json
"""

import argparse
import re
from pathlib import Path

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.guard.files import read_text
from stepdiag_ros.guard.jsontext import to_json

NAME = 'verify'
HELP = 'decide by a log before and one after whether a machine conforms'
UNLIKE_K = 0.5
"""Difference [K] from which temperatures of scales are unlike, where nothing is referred to 20 °C."""
UNITS = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6, 'µm': 1e-6, 'nm': 1e-9, 'rad': 1.0, 'mrad': 1e-3, 'urad': 1e-6, 'µrad': 1e-6}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('before', metavar='BEFORE', help='rosbag2 folder or .mcap file, measured before')
    parser.add_argument('after', metavar='AFTER', help='the same, measured after')
    parser.add_argument('--tolerance', metavar='[NAME=]VALUE', nargs='+', required=True,
                        help='such as 12um (volumetric error), E=8um, B=3um, EXX=5um, EC0Y=15urad')
    parser.add_argument('--prediction', metavar='FILE', type=Path,
                        help='prediction.json of the tables that were loaded')
    parser.add_argument('--out', metavar='DIR', type=Path, default=Path('verify'),
                        help='folder for page and numbers (default: ./verify)')
    parser.add_argument('--json', action='store_true', help='print the answer as JSON')
    parser.add_argument('--namespace', help="the machine's namespace where a log holds several")


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.bag.reader import read_log
    from stepdiag_ros.cli.evaluate import tied_lines
    from stepdiag_ros.cli.known import known_errors
    from stepdiag_ros.cli.tables import in_force
    from stepdiag_ros.compensate.applied import bare, remaining
    from stepdiag_ros.compensate.approach import standing_out
    from stepdiag_ros.compensate.document import predicted_of
    from stepdiag_ros.compensate.fit_to_act import not_metres, unfit
    from stepdiag_ros.compensate.open_directions import openness, without
    from stepdiag_ros.compensate.taken import nothing
    from stepdiag_ros.compensate.verified import CONFORMS, FAILS, verified
    from stepdiag_ros.report.compensation_words import reversal_words
    from stepdiag_ros.report.verify_page import agreement_words, verify_page

    tolerances = _tolerances(args.tolerance)
    predicted = None
    if args.prediction is not None:
        text_of_it = read_text(args.prediction, limits.TEXT_BYTES, 'prediction (--prediction)')
        predicted = predicted_of(text_of_it, str(args.prediction))
    logs = [read_log(bag, args.namespace) for bag in (args.before, args.after)]
    machine = logs[1].description.machine
    _same_machine(logs[0].description.machine, machine, args)
    solutions, reversals, notes = [], [], []
    force = ({}, {}) if predicted is None else in_force(args.prediction, predicted, machine)
    for bag, log, taken in zip((args.before, args.after), logs, force, strict=True):
        known = known_errors(bare(log, taken), bag)
        if reason := not_metres(known.solution, log):
            raise StepdiagError(f'{bag}: {reason}; nothing is verified')
        if wrong := unfit(known.solution):
            raise StepdiagError(f'{bag}: {"; ".join(wrong)}; nothing is verified')
        left = openness(known.solution)
        if left.open:
            raise StepdiagError(f'{bag}: the log leaves {", ".join(left.open)} open ({"; ".join(left.runs)}); '
                                'nothing is verified')
        solutions.append(remaining(without(known.solution, left.unmeasured), taken))
        if not nothing(taken):
            notes.append(f'{Path(bag).name}: measured under the volumetric compensation of {predicted.control}; of '
                         'each error is shown what acts on the tool point')
        reversals.append(standing_out(known.reversal))
        if reversals[-1]:
            notes.append(f'{Path(bag).name}: lost motion {reversal_words(reversals[-1])}; the volumetric error counts '
                         'each place from the worse side, the 21 errors are the mean of both')
        notes += [f'{Path(bag).name}: {line}' for line in tied_lines(known.solution)]
        notes += [f'{Path(bag).name}: {note}' for note in known.notes]
    notes += apart_words(*solutions)
    found = verified(*solutions, machine, tolerances, tuple(map(_diagonals, logs)), predicted,
                     tuple(reversals))
    tied = {when: solution.traceability.to_json_dict() if solution.traceability else None
            for when, solution in zip(('before', 'after'), solutions, strict=True)}
    document = found.to_json_dict() | {'before': args.before, 'after': args.after, 'notes': notes, 'traceability': tied}
    names = (Path(args.before).name, Path(args.after).name)
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / 'verify.json').write_text(to_json(document) + '\n', encoding='utf-8')
        (args.out / 'index.html').write_text(verify_page(found, *solutions, names, tuple(notes)), encoding='utf-8')
    except OSError as error:
        raise StepdiagError(f'{args.out}: cannot be written: {error.strerror or error}') from None
    if args.json:
        print(to_json(document))
    else:
        print(text(found))
        if found.agreement is not None:
            print(agreement_words(found.agreement))
        print(*(f'note: {note}' for note in notes), f'page: {args.out / "index.html"}', sep='\n')
    return {CONFORMS: 0, FAILS: 1}.get(found.decision, 4)


def text(found) -> str:
    """The figures for people."""
    from stepdiag_ros.report.verify_page import UNITS as SHOWN
    from stepdiag_ros.report.verify_page import number

    lines = [f'{found.machine.name}: {found.decision} (ISO 14253-1; U with k = 2, of the volumetric error 95 %)', '',
             f'{"figure":11}{"":5}{"before":>9} {"U":>7} {"after":>9} {"U":>7} {"tolerance":>10}  decision']
    for f in found.figures:
        line = (f'{f.name:11}{SHOWN[f.unit]:5}{number(f.before):>9} {number(f.before_spread):>7} '
                f'{number(f.after):>9} {number(f.after_spread):>7} {number(f.tolerance):>10}  {f.decision}')
        lines.append(line.rstrip())
    return '\n'.join(lines)


def apart_words(before, after) -> list[str]:
    """That two results hold at unlike temperatures, in words; nothing where they do not, or nobody knows."""
    one, other = before.traceability, after.traceability
    if one is None or other is None:
        return []
    unlike = one.reference_temperature != other.reference_temperature \
        or one.correction_m.keys() != other.correction_m.keys()
    if not unlike and one.reference_temperature is None:
        both = [axis for axis in one.measured_at.keys() & other.measured_at.keys()
                if f'E{axis.upper() * 2}' not in one.correction_m]
        unlike = any(abs(one.measured_at[axis] - other.measured_at[axis]) > UNLIKE_K for axis in both)
    return ['before and after hold at unlike temperatures; their positioning errors differ by their scales too: '
            'give material.scales and the temperatures of the scales for both'] if unlike else []


def _tolerances(words: list[str]) -> dict[str, float]:
    """Figure → tolerance in SI units."""
    from stepdiag_ros.compensate.verified import DIAGONAL_B, DIAGONAL_E, VOLUMETRIC
    from stepdiag_ros.model.machine import CURVES, SQUARENESS

    tolerances: dict[str, float] = {}
    for word in words:
        match = re.fullmatch(r'(?:(\w+)=)?([0-9.eE+-]+?)\s*([a-zµ]+)', word)
        try:
            value = float(match[2]) * UNITS[match[3]] if match else -1.0
        except (ValueError, KeyError):
            value = -1.0
        name = (match[1] or 'volumetric') if match else ''
        angle = name[1:2] in ('A', 'B', 'C') and len(name) > 1
        if not 0.0 < value < 1.0 or match[3].endswith('rad') != angle:
            raise StepdiagError(f'--tolerance {word!r}: give a length with its unit, such as 12um, or NAME=VALUE such '
                                'as E=8um, EXX=5um, EC0Y=15urad')
        if name not in (VOLUMETRIC, DIAGONAL_E, DIAGONAL_B, *CURVES, *SQUARENESS):
            raise StepdiagError(f'--tolerance {word!r}: {name} is no figure; there are {VOLUMETRIC}, {DIAGONAL_E}, '
                                f'{DIAGONAL_B} and the 21 errors, EXX … EA0Z')
        if name in tolerances:
            raise StepdiagError(f'--tolerance: {name} is given twice')
        tolerances[name] = value
    return tolerances


def _same_machine(before, after, args: argparse.Namespace) -> None:
    for what in ('name', 'chain', 'volume', 'tool'):
        if getattr(before, what) != getattr(after, what):
            raise StepdiagError(f'{args.before} and {args.after}: machine.{what} differs ({getattr(before, what)} and '
                                f'{getattr(after, what)}); give two logs of one machine, measured alike')


def _diagonals(log):
    """ISO 230-6 of a log in metres, with the whole budget; None where it has no complete body diagonal."""
    from stepdiag_ros.estimate.methods import run_method

    try:
        return run_method('body_diagonal', log)
    except StepdiagError:
        return None
