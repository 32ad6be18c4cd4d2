"""The page of an evaluation: curves, squareness, misalignments, residuals, what the log leaves open.

Writes DIR/index.html, which needs nothing from outside, DIR/errors.png and DIR/evaluation.json.

  stepdiag report bags/demo --out report
  stepdiag report bags/demo --out report --truth truth.json
  stepdiag report bags/demo --out report --sheets

With --sheets also DIR/sheets.html and DIR/sheets.pdf: test sheets after ISO 230-2 and ISO 230-6.
"""

import argparse
from pathlib import Path

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.guard.files import read_text, real
from stepdiag_ros.guard.jsontext import to_json

NAME = 'report'
HELP = 'figures, sheets and pages of an evaluation'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', metavar='BAG', help='rosbag2 folder or .mcap file')
    parser.add_argument('--out', metavar='DIR', type=Path, required=True, help='folder for page and pictures')
    parser.add_argument('--truth', metavar='FILE', type=Path,
                        help='known errors (JSON), drawn dashed into errors.png')
    parser.add_argument('--sheets', action='store_true',
                        help='also write test sheets after ISO 230-2 and ISO 230-6 (sheets.html, sheets.pdf)')
    parser.add_argument('--json', action='store_true', help='print the evaluation as JSON')
    parser.add_argument('--namespace', help="the machine's namespace where a log holds several")


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.bag.reader import read_log
    from stepdiag_ros.estimate.compare import truth_of
    from stepdiag_ros.estimate.evaluate import evaluate_in_full
    from stepdiag_ros.report.evaluation_page import evaluation_page
    from stepdiag_ros.report.figures import calibration_figure
    from stepdiag_ros.report.sheets.write import sheets_of, write_sheets

    log = read_log(args.bag, args.namespace)
    path = real(args.bag)
    name = path.stem if path.suffix == '.mcap' else path.name
    truth = None
    if args.truth is not None:
        text = read_text(args.truth, limits.TEXT_BYTES, 'file of known errors')
        truth = truth_of(text, log.description, name, str(args.truth))
    evaluation = evaluate_in_full(log)
    solution = evaluation.solution
    sheets = sheets_of(log, evaluation, name) if args.sheets else []
    document = solution.to_json_dict()
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / 'index.html').write_text(evaluation_page(solution, log.description, name), encoding='utf-8')
        (args.out / 'evaluation.json').write_text(to_json(document), encoding='utf-8')
    except OSError as error:
        raise StepdiagError(f'{args.out}: cannot be written: {error.strerror or error}') from None
    calibration_figure(solution, truth, args.out / 'errors.png')
    written = write_sheets(sheets, name, args.out) if sheets else ()
    if args.json:
        print(to_json(document))
    else:
        for path in (args.out / 'index.html', *written):
            print(path)
    return 0
