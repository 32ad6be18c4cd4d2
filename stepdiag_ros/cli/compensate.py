"""Compensation tables for a control, from a log, that cannot harm.

Evaluates the log, writes the tables of the format asked for into DIR for a functional point, on top of what the
control holds (--present), with the way back (before/), the prediction (prediction.json, prediction.png) and what to do
(README.txt).  Coordinates are in metres; --origin, --line and --workpiece are machine coordinates.

Nothing is written, and the exit status is 2, where the log leaves open what the tables are made of (unless
--partial), where lengths are not corrected for air, where the machine would not become better, and where any place of
the volume would become worse beyond its U.  Tables of single axes are held back as far as that takes; --exact asks for
those of the line as they are, or none.

  stepdiag compensate bags/monday --format linuxcnc --out tables --origin -0.5,0,-0.3
  stepdiag compensate bags/monday --format heidenhain --out tables --tool 0,0,-0.18 --present X_AXIS.COM Y_AXIS.COM
"""

import argparse
from pathlib import Path

from stepdiag_ros.cli.vector import vector
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits
from stepdiag_ros.guard.files import read_text, real
from stepdiag_ros.guard.jsontext import to_json

NAME = 'compensate'
HELP = 'compensation tables for a control'
FORMATS = ('linuxcnc', 'linuxcnc-matrix', 'linuxcnc-volume', 'sinumerik', 'heidenhain', 'etalon', 'isg')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', metavar='BAG', help='rosbag2 folder or .mcap file')
    parser.add_argument('--format', required=True, choices=FORMATS, help='whose tables')
    parser.add_argument('--out', metavar='DIR', type=Path, required=True, help='folder for the tables')
    parser.add_argument('--origin', metavar='X,Y,Z', help="machine coordinates [m] of the volume's lower corner "
                                                          '(default: machine.origin of the log)')
    parser.add_argument('--tool', metavar='X,Y,Z', help="tool vector [m] of the functional point (default: the log's)")
    parser.add_argument('--line', metavar='X,Y,Z', help='machine coordinates [m] through which the lines go along '
                                                        'which tables of single axes are right (default: middle)')
    parser.add_argument('--workpiece', metavar='X,Y,Z', help="the same, named by where the tool's tip works")
    parser.add_argument('--volume', action='store_true', help='tables of single axes that serve the whole volume best '
                                                              'instead of a line')
    parser.add_argument('--present', metavar='FILE', type=Path, nargs='+', default=[],
                        help='what the control holds now, files or folders; the sum is written')
    parser.add_argument('--partial', action='store_true', help='leave out what the log leaves open')
    parser.add_argument('--exact', action='store_true', help='the tables of the line as they are, or none')
    parser.add_argument('--json', action='store_true', help='print the prediction as JSON')
    parser.add_argument('--namespace', help="the machine's namespace where a log holds several")


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.bag.reader import read_log
    from stepdiag_ros.cli.known import known_errors
    from stepdiag_ros.cli.tables import PICTURE, README, write_tables
    from stepdiag_ros.compensate.applied import bare, remaining
    from stepdiag_ros.compensate.compensation import compensation, place_of
    from stepdiag_ros.compensate.controls import CONTROLS
    from stepdiag_ros.compensate.document import NAME as PREDICTION
    from stepdiag_ros.compensate.document import document
    from stepdiag_ros.compensate.fit_to_act import not_metres
    from stepdiag_ros.report.compensation_words import summary

    origin, tool, line, workpiece = (None if text is None else vector(text, f'--{name}') for name, text in (
        ('origin', args.origin), ('tool', args.tool), ('line', args.line), ('workpiece', args.workpiece)))
    if args.volume and (line is not None or workpiece is not None):
        raise StepdiagError('--volume serves no line; leave --line and --workpiece away')
    if line is not None and workpiece is not None:
        raise StepdiagError('--line and --workpiece both name the lines; give one of them')
    present = _present(args.present)
    _must_be_new(args.out)
    log = read_log(args.bag, args.namespace)
    machine = log.description.machine
    place, control = place_of(machine, origin), CONTROLS[args.format]
    origin = place.origin
    point = _point(machine, origin, tool, line, workpiece)
    # Rotations whose effect is taken off are still there: found are the machine's own errors, and then what remains.
    held = control.read(present, place) if present and control.whole_model else {}
    known = known_errors(bare(log, held), args.bag)
    found = compensation(remaining(known.solution, held), machine, control, origin, point, present, args.partial,
                         args.exact, not_metres(known.solution, log), args.volume, known.reversal)
    if args.json:
        print(to_json(document(found, args.bag)))
    found.checked()
    write_tables(found, real(args.bag).stem, args.out)
    if not args.json:
        print(summary(found))
        for file in (*found.files, PICTURE, PREDICTION, README):
            print(args.out / file)
        print(f'the way back: {args.out / "before"}')
        for note in known.notes:
            print(f'note: {note}')
    return 0


def _point(machine, origin, tool, line, workpiece):
    """The functional point that the options name, None for the default."""
    from stepdiag_ros.compensate.functional import functional_point

    if tool is None and line is None and workpiece is None:
        return None
    return functional_point(machine, tool, None if line is None else line - origin,
                            None if workpiece is None else workpiece - origin)


def _present(paths: list[Path]) -> dict[str, str]:
    """Texts of what the control holds, by name; folders give all their files."""
    files: dict[str, str] = {}
    found = [file for path in paths for file in
             (sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path])]
    for path in found:
        if path.name in ('prediction.json', 'prediction.png', 'README.txt'):
            continue
        if path.name in files:
            raise StepdiagError(f'--present: two files are called {path.name}; give those that the control holds')
        files[path.name] = read_text(path, limits.TEXT_BYTES, 'table that the control holds (--present)')
    return files


def _must_be_new(out: Path) -> None:
    """A folder with something in it is left alone: tables of another day beside these would be loaded with them."""
    if out.is_file():
        raise StepdiagError(f'{out}: is a file; name a folder with --out')
    if out.is_dir() and any(out.iterdir()):
        raise StepdiagError(f'{out}: holds other files; name a new folder with --out, so that nothing is overwritten')
