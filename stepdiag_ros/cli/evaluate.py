"""Evaluate a log: the 21 errors with their uncertainties.

By default with the enhanced step diagonal method; --method takes another one that the log
holds enough for.

  stepdiag evaluate bags/demo
  stepdiag evaluate log.mcap --json > errors.json
  stepdiag evaluate bags/demo --method step_diagonal

Ends with status 1 where the answer is not ok: the log shows a mistake of commissioning, the residuals are larger
than noise, nothing checks the model, or lengths are not corrected for air.  The answer is printed all the same, with
the reason.
"""

import argparse
from typing import Any

import numpy as np

from stepdiag_ros.bag.reader import read_log
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.body_diagonal import DiagonalTest
from stepdiag_ros.estimate.cautions import cautions
from stepdiag_ros.estimate.closure import said
from stepdiag_ros.estimate.contributions import listed
from stepdiag_ros.estimate.evaluate import evaluate_in_full
from stepdiag_ros.estimate.gauge import STRAIGHTNESS
from stepdiag_ros.estimate.identifiability import LOOSELY
from stepdiag_ros.estimate.iso230_2 import LinearTest
from stepdiag_ros.estimate.method_budget import Readings
from stepdiag_ros.estimate.methods import METHODS, run_method
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.status import OK
from stepdiag_ros.estimate.traceability import WORDS
from stepdiag_ros.guard.jsontext import to_json
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.machine import CURVES, SQUARENESS

NAME = 'evaluate'
HELP = 'evaluate a log: the 21 errors with their uncertainties'
FAR_FROM_MODEL = 2.0
"""Reduced χ² above which a reader is sent to `stepdiag gap`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', metavar='BAG', nargs='+', help='rosbag2 folder or .mcap file')
    parser.add_argument('--method', default='enhanced', choices=list(METHODS),
                        help='method of evaluation (default: enhanced)')
    parser.add_argument('--namespace', help="the machine's namespace where a log holds several")
    parser.add_argument('--json', action='store_true', help='print the whole answer as JSON')


def run(args: argparse.Namespace) -> int:
    answers, others, failed = {}, {}, []
    for bag in args.bag:
        try:
            answers[bag], others[bag] = _answer(args.method, read_log(bag, args.namespace))
        except StepdiagError as error:
            if len(args.bag) == 1:
                raise
            failed.append(str(error))
    if args.json:
        documents = {bag: result.to_json_dict() | ({'cautions': list(others[bag])} if others[bag] else {})
                     for bag, result in answers.items()}
        whole = documents if len(args.bag) > 1 else next(iter(documents.values()))
        print(to_json(whole))
    else:
        for bag, result in answers.items():
            print(text(bag, result) if isinstance(result, Solution) else figures_text(bag, result))
            for caution in others[bag]:
                print(f'caution, for other methods than this one: {caution}')
    if failed:
        raise StepdiagError('; '.join(failed))
    return 0 if all(getattr(result, 'status', OK) == OK for result in answers.values()) else 1


def _answer(method: str, log: CalibrationLog) -> tuple[Any, tuple[str, ...]]:
    """What a method makes of a log, and the cautions for other methods; those have their own in their answers."""
    if method != 'enhanced':
        return run_method(method, log), ()
    evaluation = evaluate_in_full(log)
    solution = evaluation.solution
    return solution, () if solution.sanity else cautions(Readings.of(evaluation).measured, solution)


def tied_lines(result: Solution | DiagonalTest | LinearTest) -> list[str]:
    """How a result is tied to the metre and to 20 °C, a line each; none where that was not looked at."""
    tied = result.traceability
    if tied is None:
        return []
    return [f'lengths: {WORDS[tied.air]}; U of the unit of length {2e6 * tied.index_sigma:.2g} µm/m (k=2)',
            f'positioning errors: {tied.temperature_words}', f'parts: {tied.workpiece_words}',
            f'uncertainty: {"the budget of the cell" if tied.budget == "cell" else "the standard budget"}']


def figures_text(bag: str, result: DiagonalTest | LinearTest) -> str:
    """A test's figures for people, with what they rest on."""
    tied = result.traceability
    head = [] if result.status == OK else [f'{bag}: {result.status}']
    return '\n'.join([*head, f'{bag}: {result.text()}', '', *tied_lines(result),
                      *(f'warning: {bag}: {remark}' for remark in (tied.remarks if tied else ())),
                      *(f'remark: {remark}' for remark in result.remarks)])


def text(bag: str, solution: Solution) -> str:
    """The answer for people: each curve's range and uncertainty, squareness, what is not known."""
    lines = [f'{bag}: {solution.method}, {solution.status}']
    lines += [f'Not sane: {finding}.' for finding in solution.sanity]
    if solution.reduced_chi2 is not None:
        lines.append(f'reduced χ² {solution.reduced_chi2:.3f} with {solution.dof} degrees of freedom')
    if solution.noise:
        lines.append('noise from {source}: position {p:.3f} µm, angle {a:.3f} µrad (1σ an arrival)'.format(
            source=solution.noise['source'], p=1e6 * solution.noise['position_repeatability_m'],
            a=1e6 * solution.noise['angle_repeatability_rad']))
    lines += tied_lines(solution)
    lines += ['', f'{"error":6} {"least":>9} {"greatest":>9} {"U (k=2)":>9} {"repeats":>9}']
    blind = {entry.names[0] for entry in solution.unidentifiable if len(entry.names) == 1}
    unseen = [name for name in CURVES + SQUARENESS
              if name in blind or name not in STRAIGHTNESS and f'{name} slope' in blind]
    for name in CURVES:
        if solution.has(name) and name not in unseen:
            _, value, sigma = solution.curve(name)
            unit = 'µm' if name[1] in 'XYZ' else 'µrad'
            lines.append(f'{name:6} {1e6 * value.min():9.3f} {1e6 * value.max():9.3f} '
                         f'{2e6 * sigma.max():9.3f} {2e6 * solution.curve_repeatability(name).max():9.3f} {unit}')
    for name in SQUARENESS:
        if solution.has(name) and name not in unseen:
            value, sigma = solution.squareness(name)
            lines.append(f'{name:6} {1e6 * value:9.3f} {"":9} {2e6 * sigma:9.3f} '
                         f'{2e6 * solution.curve_repeatability(name)[0]:9.3f} µrad')
    if solution.traceability is not None:
        lines += ['', 'U: whole budget; repeats: what repeats, or the noise that the cell declares, give of it; both '
                  'k = 2.']
        shown = {name: values for name, values in solution.traceability.correction_m.items() if np.any(values)}
        lines += [f'Referred to 20 °C: {name} corrected by {1e6 * values[-1]:+.3f} ± '
                  f'{2e6 * solution.traceability.correction_sigma_m[name][-1]:.3f} µm (k = 2) at its end.'
                  for name, values in shown.items()]
    if solution.gauge:
        lines += ['', f'Counted as: {solution.gauge}.']
    loose = {entry.names[0].removesuffix(' slope') for entry in solution.unidentifiable if entry.why == LOOSELY}
    nothing = [name for name in unseen if name not in loose]
    if nothing:
        lines += ['', f'No reading of this log depends on {", ".join(nothing)}.']
    reasons: dict[str, list[str]] = {}
    for entry in solution.unidentifiable:
        if entry.names[0].removesuffix(' slope') not in nothing:
            reasons.setdefault(entry.why, []).append(' with '.join(entry.names))
    if reasons:
        lines += ['', 'Cannot be identified from this log:']
        lines += [f'  {"; ".join(names)}: {why}' for why, names in reasons.items()]
    if solution.parts:
        lines += ['', 'What each part contributed (U by repeats):', *(f'  {line}' for line in listed(solution.parts))]
    closing = said(solution.closure)
    if closing:
        lines += ['', f'Closure: {closing}.']
    lines += [f'warning: {warning}' for warning in solution.warnings]
    if solution.method == 'enhanced' and not solution.sanity and (solution.reduced_chi2 or 0.0) > FAR_FROM_MODEL:
        lines.append(f'The rigid-body model does not describe this log: stepdiag gap {bag} says why.')
    return '\n'.join(lines)
