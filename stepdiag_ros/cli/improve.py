"""Calibrate a machine, compensate its LinuxCNC, calibrate it again, and say what it brought.

CELL.yaml names the folder of the control's configuration (`instruments.cnc.config`) and where the volume lies
in machine coordinates (`machine.origin`).  After the first calibration the command shows what the machine will be
like and which files it would write, and writes nothing before you agree (or --yes).  What the files replace is kept;
--undo puts it back.  Exit status 0: better, as predicted, and no stop worse than before beyond U.

  stepdiag improve mill.yaml                    the volumetric component: all 21 errors (stepdiagkins)
  stepdiag improve mill.yaml --level tables     LinuxCNC's own screw tables: three of them
  stepdiag improve mill.yaml --hardware         instruments and control are real; you restart LinuxCNC when asked
  stepdiag improve mill.yaml --undo
"""

import argparse
import os
import sys
import time
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stepdiag_ros.cli.progress import Bar
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits, strict_yaml
from stepdiag_ros.guard.files import read_text, real
from stepdiag_ros.guard.jsontext import to_json

if TYPE_CHECKING:
    from stepdiag_ros.improve.levels import Change

NAME = 'improve'
HELP = 'calibrate, compensate LinuxCNC, calibrate again, and say what it brought'
MICRO, TABLES = 1e6, 'tables'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('cell', metavar='CELL.yaml', type=Path, help='cell file')
    parser.add_argument('--level', choices=('tables', 'matrix', 'volume'), default='volume',
                        help='screw tables; these and squareness by matrixkins; all 21 errors (default)')
    parser.add_argument('--undo', action='store_true',
                        help='put back what the last change replaced, and measure nothing')
    parser.add_argument('--yes', action='store_true', help='write without asking')
    parser.add_argument('--hardware', action='store_true', help='the instruments and the control are real')
    parser.add_argument('--partial', action='store_true', help='leave out what the log leaves open')
    parser.add_argument('--out', metavar='DIR', type=Path, help='folder for bags and result (default: a new one here)')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')
    parser.set_defaults(setups=[], repeats=0, steps=0, dwell=0.0)


@dataclass
class _Loop:
    """What both calibrations share."""

    args: argparse.Namespace
    out: Path
    say: Any
    domain: int | None


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.improve import backup
    from stepdiag_ros.nodes.environment import free_domain
    from stepdiag_ros.virtual.cell import load_cell
    from stepdiag_ros.virtual.linuxcnc_server import config_folder, prepare

    cell = load_cell(args.cell)
    folder = config_folder(cell)
    if folder is None:
        raise StepdiagError(f"{args.cell}: instruments.cnc.config is missing; name the folder of LinuxCNC's "
                            'configuration there')
    if args.undo:
        back, edited = backup.undo(folder)
        for name in back:
            print(f'put back: {folder / name}')
        for name in edited:
            print(f'edited since, kept as: {folder / name}')
        print('restart LinuxCNC and home it; until then it moves as before')
        return 0
    if not args.hardware and cell.instruments.control != 'linuxcnc':
        raise StepdiagError(f'{args.cell}: instruments.cnc.control is {cell.instruments.control!r}, a control that '
                            'cannot be compensated; write linuxcnc, or give --hardware for a real machine')
    if cell.instruments.multiplexer:
        raise StepdiagError(f'{args.cell}: shares its interferometer; improve one machine at a time, without '
                            'multiplexer')
    if cell.description.machine.origin is None:
        raise StepdiagError(f"{args.cell}: machine.origin is missing; give the machine coordinates [m] of the volume's "
                            'lower corner, the tables are written in them')
    if args.hardware:
        from stepdiag_ros.linuxcnc.configuration import ini_file
        ini_file(folder)
    else:
        prepare(cell, folder)
    out = Path(f'stepdiag_improve_{datetime.now():%Y%m%d_%H%M%S}') if args.out is None else args.out
    if out.exists() and any(out.iterdir()):
        raise StepdiagError(f'{out}: is not empty; give a new --out')
    out.mkdir(parents=True, exist_ok=True)
    bar = Bar('calibrating', quiet=args.json)
    loop = _Loop(args, out, bar.say, None if 'ROS_DOMAIN_ID' in os.environ else free_domain())
    return _improve(loop, cell, folder)


def _improve(loop: _Loop, cell: Any, folder: Path) -> int:
    from stepdiag_ros.cli.evaluate import tied_lines
    from stepdiag_ros.cli.known import known_errors
    from stepdiag_ros.cli.tables import write_tables
    from stepdiag_ros.compensate.applied import bare
    from stepdiag_ros.compensate.fit_to_act import not_metres, unfit
    from stepdiag_ros.improve import backup, levels
    from stepdiag_ros.improve.outcome import outcome
    from stepdiag_ros.linuxcnc import configuration
    from stepdiag_ros.linuxcnc.install import installed

    args, machine, began = loop.args, cell.description.machine, time.monotonic()
    _components(args, folder)
    present = levels.held(folder)
    log = _calibrated(loop, args.cell, 'before')
    applied = present.model(machine)
    measured = bare(log, applied)
    known = known_errors(measured, str(loop.out / 'before'))
    first = known.solution
    wanted = levels.change(args.level, first, machine, present, partial=args.partial, air=not_metres(first, log),
                           matrixkins=installed('matrixkins'), reversal=known.reversal)
    wanted = replace(wanted, notes=(*wanted.notes, *known.notes))
    if not args.json:
        print('\n'.join(tied_lines(first)))
        print(_plan(wanted, folder))
    if wanted.refusals:
        raise StepdiagError('nothing written: ' + '; '.join(wanted.refusals))
    if not _agreed(args, folder):
        print('nothing written')
        return 1
    write_tables(wanted.made, 'before', loop.out / TABLES)
    kept = backup.keep(folder, wanted.files)
    configuration.write(folder, wanted.files)
    loop.say(f'written into {folder}; what was there is in {kept}')
    if args.hardware:
        _restarted()
    again = _calibrated(loop, args.cell if args.hardware else _fresh_noise(args.cell, cell, loop.out), 'after')
    under = bare(again, wanted.applied)
    then = known_errors(under, str(loop.out / 'after'))
    found, wrong = outcome(wanted, first, applied, then.solution, under, then.reversal), unfit(then.solution)
    for note in (*wrong, *then.notes):
        loop.say(f'after: {note}')
    document = {'level': args.level, 'configuration': str(folder), 'backup': str(kept),
                'seconds': round(time.monotonic() - began, 1), **found.to_json_dict()}
    (loop.out / 'improve.json').write_text(to_json(document) + '\n', encoding='utf-8')
    print(to_json(document) if args.json else _result(found, args, loop.out))
    return 0 if found.as_predicted and found.better and not wrong else 1


def _components(args: argparse.Namespace, folder: Path) -> None:
    """On this computer the components must be installed before anything is measured."""
    from stepdiag_ros.linuxcnc.install import installed
    if args.level != 'tables' and not args.hardware and not installed('stepdiagkins'):
        raise StepdiagError('stepdiagkins is not installed; run: sudo stepdiag linuxcnc install')
    if not os.access(folder, os.W_OK):
        raise StepdiagError(f'{folder}: may not be written; run as its owner')


def _calibrated(loop: _Loop, cell_file: Path, name: str) -> Any:
    """One calibration into a bag of the output folder; its log."""
    from stepdiag_ros.bag.reader import read_log
    from stepdiag_ros.cli.calibrate import measure
    from stepdiag_ros.nodes.bringup import Bringup

    bag, bar = (loop.out / name).absolute(), Bar(f'calibrating, {name}', quiet=loop.args.json)
    with Bringup(cell_file, hardware=loop.args.hardware, bag=bag, runtime=loop.out / f'run_{name}',
                 domain=loop.domain, say=bar.say) as cell:
        done = measure(cell.operator, bar, loop.args, cell.watch)
        bar.close()
        if not done.succeeded:
            raise StepdiagError(f'the calibration {name} the change was {done.how}: {done.message}; the logs of the '
                                f'nodes are in {loop.out / f"run_{name}"}'
                                + ('' if name == 'before' else f'; stepdiag improve {loop.args.cell} --undo puts the '
                                                               'control back'))
    return read_log(bag)


def _fresh_noise(path: Path, cell: Any, out: Path) -> Path:
    """The same virtual machine on another day: what is drawn as its errors stays, noise is drawn anew."""
    import yaml
    text = strict_yaml.load(read_text(path, limits.YAML_BYTES, 'cell file'), str(path))
    for key in ('geometry', 'misalignments'):
        text[key] = {'seed': cell.seed, **(text.get(key) or {})}
    text['seed'] = cell.seed + 1
    text['instruments']['cnc']['config'] = str(real(path.parent / cell.instruments.config))
    again = out / 'cell_after.yaml'
    again.write_text(yaml.safe_dump(text, sort_keys=False), encoding='utf-8')
    return again


def _plan(change: 'Change', folder: Path) -> str:
    """What the machine is like, would be like, and what would be written."""
    now, then = change.made.worst_before, change.made.worst_after
    lines = [f'largest deviation in the volume, {when:20} {MICRO * size:8.2f} µm, U = {MICRO * spread:.2f} µm (95 %)'
             for when, (size, spread, _) in (('now', now), (f'with level {change.level}', then))]
    lines += [f'files in {folder}:'] * bool(change.files)
    lines += [f'  {"write" if text is not None else "remove"} {name}' for name, text in change.files.items()
              if text is not None or (folder / name).exists()]
    return '\n'.join([*lines, *(f'note: {note}' for note in change.notes)])


def _agreed(args: argparse.Namespace, folder: Path) -> bool:
    if args.yes:
        return True
    if args.json or not sys.stdin.isatty():
        raise StepdiagError(f'nothing written into {folder}: nobody can be asked here; give --yes to agree beforehand')
    print('Write these files? [y/N] ', end='', flush=True)
    return sys.stdin.readline().strip().lower() in ('y', 'yes')


def _restarted() -> None:
    print('Restart LinuxCNC, start its linuxcncrsh, home the machine, then press Enter.', file=sys.stderr, flush=True)
    if not sys.stdin.readline():
        raise StepdiagError('nobody confirmed that LinuxCNC was restarted; calibrate again by hand, or take the '
                            'change back with --undo')


def _result(found: Any, args: argparse.Namespace, out: Path) -> str:
    rows = [f'largest deviation in the volume, {name:9} {MICRO * size:8.2f} µm, U = {MICRO * spread:.2f} µm (95 %)'
            for name, (size, spread, _) in found.largest.items()]
    worse = int((found.stops.worse > 0.0).sum())
    rows += [f'smaller by a factor of {found.factor:.1f}',
             f'from the prediction it is off by {MICRO * found.off_m:.2f} µm at most; noise alone stays below '
             f'{MICRO * found.off_bound_m:.2f} µm in 95 % of all cases: '
             + ('as predicted' if found.as_predicted else 'NOT as predicted'),
             f'{len(found.stops.name)} stops, {worse or "none"} worse than before beyond U (95 % for all together)',
             f'result: {out / "improve.json"}; for a decision: stepdiag verify {out / "before"} {out / "after"} '
             f'--prediction {out / TABLES / "prediction.json"} --tolerance …']
    if not (found.as_predicted and found.better):
        rows.append(f'The machine is not what was predicted: stepdiag improve {args.cell} --undo takes the change back')
    return '\n'.join(rows)
