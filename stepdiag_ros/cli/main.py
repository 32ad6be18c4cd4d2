"""``stepdiag``: one command, one module a subcommand.

A subcommand is a module of this package with ``NAME``, ``HELP``,
``add_arguments(parser)`` and ``run(args) -> int``.  Only the module of the command
that was asked for is imported, so ``stepdiag info`` works without ROS; the general
help takes the one-line texts from the table below.
"""

import argparse
import importlib
import os
import re
import sys
import traceback
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from importlib import metadata
from pathlib import Path
from typing import TextIO, cast

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard.missing import missing
from stepdiag_ros.guard.show import SafeStream

#: Command, its module, and what the general help says of it, in the order of the help.
COMMANDS: tuple[tuple[str, str, str], ...] = (
    ('demo', 'demo', 'bring a virtual machine up, calibrate it, show the errors found'),
    ('up', 'up', 'start a cell from its YAML file and watch over it until Ctrl-C'),
    ('hall', 'hall', 'start many cells that share one laser, and watch over them until Ctrl-C'),
    ('parameters', 'parameters', "write the parameter file of a cell's nodes, for ros2 launch"),
    ('calibrate', 'calibrate', 'run the calibration on a cell and evaluate it'),
    ('watch', 'watch', "show who has the laser's light and how far each machine is"),
    ('web', 'web', 'serve a page that shows what runs, live'),
    ('simulate', 'simulate', 'write the log of a virtual cell without running the graph'),
    ('evaluate', 'evaluate', 'evaluate a log: the 21 errors with their uncertainties'),
    ('compare', 'compare', 'evaluate a log with every method that fits it, side by side'),
    ('uncertainty', 'uncertainty', 'an uncertainty budget carried to every error and to any point'),
    ('map', 'map', 'the volumetric error that a solution predicts'),
    ('gap', 'gap', 'where log and simulator disagree, why, and how far it closes'),
    ('effect', 'effect', 'check an effect of your own: simulate it, find it, say with what it is confounded'),
    ('blind', 'blind', 'seal, answer and open the blind check of the diagnosis'),
    ('report', 'report', 'figures, sheets and pages of an evaluation'),
    ('compensate', 'compensate', 'compensation tables for a control that cannot harm'),
    ('verify', 'verify', 'decide by a log before and one after whether a machine conforms'),
    ('improve', 'improve', 'calibrate, compensate LinuxCNC, calibrate again, and say what it brought'),
    ('linuxcnc', 'linuxcnc', 'install the components for LinuxCNC, add the watchdog to a configuration'),
    ('replay', 'replay', "send a log through the solver node's own function, or onto topics"),
    ('info', 'info', 'what a bag holds and what is missing'),
    ('recover', 'recover', 'mend a torn bag and say what is lost'),
    ('import', 'import_', 'bring a table of measurements (CSV) in as a bag'),
    ('scene', 'scene', 'draw the beams, the mirror and the path of a cell'),
)

DESCRIPTION = """\
In-machine calibration of three-axis machine tools by the enhanced laser step diagonal method.
"""

EPILOG = """\
Start with `stepdiag demo`.  `stepdiag COMMAND --help` explains a command.
Exit status: 0 done, 1 a check was not passed, 2 bad input (one line says what), 3 a fault of the program
itself (one line says which; STEPDIAG_TRACEBACK=1 shows where), 4 a check is undecided, 130 interrupted.
"""


def _available() -> list[tuple[str, str, str]]:
    """The commands whose modules are installed."""
    package = importlib.import_module('stepdiag_ros.cli')
    folders = [folder for folder in package.__path__ if os.path.isdir(folder)]
    return [entry for entry in COMMANDS
            if any(os.path.exists(os.path.join(folder, f'{entry[1]}.py')) for folder in folders)]


def build_parser(asked: str | None) -> argparse.ArgumentParser:
    """The parser; only the subcommand ``asked`` for gets its arguments."""
    parser = argparse.ArgumentParser(prog='stepdiag', description=DESCRIPTION, epilog=EPILOG,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--version', action='version', version=f'stepdiag {_version()}')
    commands = parser.add_subparsers(dest='command', metavar='COMMAND', required=True)
    for name, module_name, text in _available():
        if name != asked:
            commands.add_parser(name, help=text)
            continue
        module = importlib.import_module(f'stepdiag_ros.cli.{module_name}')
        sub = commands.add_parser(name, help=text, description=module.__doc__ or module.HELP,
                                  formatter_class=argparse.RawDescriptionHelpFormatter)
        module.add_arguments(sub)
        sub.set_defaults(run=module.run)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    argv = list(sys.argv[1:] if argv is None else argv)
    asked = next((word for word in argv if not word.startswith('-')), None)
    # Names in logs, cell files and answers reach a terminal through these two streams only.
    with redirect_stdout(cast(TextIO, SafeStream(sys.stdout))), redirect_stderr(cast(TextIO, SafeStream(sys.stderr))):
        return _run(asked, argv)


def _run(asked: str | None, argv: list[str]) -> int:
    try:
        args = build_parser(asked).parse_args(_joined(argv))
        return int(args.run(args) or 0)
    except StepdiagError as error:
        print(f'stepdiag: {one_line(str(error))}', file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        if not error.name or error.name.split('.')[0] == 'stepdiag_ros':
            return _fault(asked, error)
        print(f'stepdiag: {asked} needs {missing(error.name)}', file=sys.stderr)
        return 2
    except (MemoryError, RecursionError) as error:
        print(f'stepdiag: {asked}: what it was given needs more than this computer has ({type(error).__name__})',
              file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('stepdiag: interrupted', file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader of our output has gone (`stepdiag … | head`): nothing is left to say.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        return _fault(asked, error)


def _joined(argv: list[str]) -> list[str]:
    """``--origin -0.5,0,0`` as ``--origin=-0.5,0,0``: argparse takes what begins with a minus sign for an option."""
    words: list[str] = []
    for word in argv:
        if words and re.fullmatch(r'--\w[\w-]*', words[-1]) and re.match(r'-[0-9.][^,]*,', word):
            words[-1] += f'={word}'
        else:
            words.append(word)
    return words


def _fault(asked: str | None, error: Exception) -> int:
    """One line about a fault of the program itself; never a traceback that nobody asked for."""
    if os.environ.get('STEPDIAG_TRACEBACK'):
        traceback.print_exception(error)
    frame = traceback.extract_tb(error.__traceback__)[-1]
    print(f'stepdiag: {asked}: internal fault, {type(error).__name__}: {one_line(str(error))[:200]} '
          f'({Path(frame.filename).name}:{frame.lineno}); please report it with its input', file=sys.stderr)
    return 3


def one_line(text: str) -> str:
    """``text`` with its line breaks made spaces."""
    return ' '.join(text.split('\n'))


def _version() -> str:
    try:
        return metadata.version('stepdiag_ros')
    except metadata.PackageNotFoundError:
        return 'unknown'


if __name__ == '__main__':
    sys.exit(main())
