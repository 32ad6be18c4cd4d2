"""Runs one command in a process of its own, under limits, and judges what it did.

Every module is imported once; each run is a fork, so that a thousand runs cost a thousand forks and not a
thousand imports.
"""

import contextlib
import json
import os
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass, replace
from pathlib import Path

import bags

for name in ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS'):
    os.environ[name] = '1'
os.environ['MPLBACKEND'] = 'Agg'

CPU_S, CHECK_CPU_S = 30, 120
"""The second is that of ``effect check``, which simulates, fits and diagnoses."""
WALL_S = 60.0
MEMORY = 1 << 30
ADDRESSES = 4 << 30
COMMANDS = ('info', 'recover', 'evaluate', 'compare', 'gap', 'map', 'report', 'sheets', 'replay', 'uncertainty', 'compensate', 'verify')
#: Commands that are given a Python file with an effect.
EFFECT_COMMANDS = ('effect', 'effect simulate', 'effect gap')
#: What comes with a command that is not an error: the statuses it may end with.
STATUSES = (0, 1, 2, 4)
#: A line of a progress bar.
PROGRESS = re.compile(r'^\w+ \[.*\] \d+/\d+', re.MULTILINE)
PYTHON_WARNING = re.compile(r'^\S+:\d+: \w*Warning: .*\n(?:  .*\n)?', re.MULTILINE)


@dataclass(frozen=True)
class Outcome:
    """How a run ended: exit status (negative: by that signal), what it wrote, seconds of processor, memory [byte]."""

    argv: tuple[str, ...]
    status: int
    out: str
    err: str
    cpu_s: float
    memory: int


def warm_up() -> None:
    """Import what the commands import, once for all forks."""
    import matplotlib.pyplot  # noqa: F401

    import stepdiag_ros.cli.compare
    import stepdiag_ros.cli.compensate
    import stepdiag_ros.cli.effect
    import stepdiag_ros.cli.evaluate
    import stepdiag_ros.cli.gap
    import stepdiag_ros.cli.import_
    import stepdiag_ros.cli.info
    import stepdiag_ros.cli.map
    import stepdiag_ros.cli.recover
    import stepdiag_ros.cli.replay
    import stepdiag_ros.cli.report
    import stepdiag_ros.cli.simulate
    import stepdiag_ros.cli.uncertainty
    import stepdiag_ros.cli.verify
    import stepdiag_ros.report.evaluation_page
    import stepdiag_ros.report.gap_page  # noqa: F401
    from stepdiag_ros.effects import all_effects
    all_effects()


def arguments(command: str, given: Path, folder: Path) -> list[str]:
    """The command line that runs ``command`` on the input."""
    bag = str(given)
    sound = str(given.parent.parent / 'diagonals')
    if command.startswith('effect '):
        cell = given.parent / 'cell.yaml'
        cell.write_text(f'{bags.CELL}effects: {{own: {{file: {given.name}, amp: 1.0e-5, tau: 20.0}}}}\n', encoding='utf-8')
        if command == 'effect simulate':
            return ['simulate', str(cell), '--effect', bag, '--out', str(folder / 'made'), '--json']
        return ['gap', sound, '--effect', bag, '--out', str(folder / 'gap'), '--json']
    return {'info': ['info', bag, '--json'], 'recover': ['recover', bag, '--to', str(folder / 'mended'), '--json'],
            'evaluate': ['evaluate', bag, '--json'], 'compare': ['compare', bag, '--json'],
            'gap': ['gap', bag, '--out', str(folder / 'gap'), '--json'], 'map': ['map', bag, '--json'],
            'report': ['report', bag, '--out', str(folder / 'report'), '--json'],
            'sheets': ['report', bag, '--sheets', '--out', str(folder / 'sheets'), '--json'],
            'compensate': ['compensate', bag, '--format', 'linuxcnc', '--origin', '0,0,0', '--partial', '--out', str(folder / 'tables'),
                           '--json'],
            'verify': ['verify', bag, bag, '--tolerance', '12um', 'E=8um', '--out', str(folder / 'verify'), '--json'],
            'effect': ['effect', 'check', bag, '--json'],
            'truth': ['report', sound, '--truth', bag, '--out', str(folder / 'report'), '--json'],
            'budget': ['uncertainty', sound, '--budget', bag, '--json'],
            'replay': ['replay', bag, '--json'], 'uncertainty': ['uncertainty', bag, '--json'],
            'import': ['import', bag, '--to', str(folder / 'imported'), '--json'],
            'simulate': ['simulate', bag, '--out', str(folder / 'made'), '--json'],
            'simulate shown': ['simulate', bag, '--out', str(folder / 'shown')]}[command]


def run(argv: list[str]) -> Outcome:
    """Run ``stepdiag ARGV`` in a fork."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork()
        if child == 0:
            _in_child(argv, out.fileno(), err.fileno())
        status, usage = _wait(child)
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read().decode('utf-8', 'replace'))
    return Outcome(tuple(argv), status, *texts, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024)


def _in_child(argv: list[str], out: int, err: int) -> None:
    status = 70
    try:
        os.setsid()
        os.dup2(out, 1)
        os.dup2(err, 2)
        sys.stdout = open(1, 'w', encoding='utf-8', errors='surrogateescape', closefd=False)
        sys.stderr = open(2, 'w', encoding='utf-8', errors='surrogateescape', closefd=False)
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
        cpu_s = CHECK_CPU_S if argv[0] == 'effect' else CPU_S
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 5))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30, 1 << 30))
        from stepdiag_ros.cli.main import main
        try:
            status = main(argv)
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 1
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        with contextlib.suppress(BaseException):
            os.write(2, traceback.format_exc().encode('utf-8', 'replace'))
    finally:
        os._exit(status)


def _wait(child: int) -> tuple[int, resource.struct_rusage]:
    began, killed = time.monotonic(), False
    while True:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        if pid:
            return os.waitstatus_to_exitcode(status), usage
        if not killed and time.monotonic() - began > WALL_S + _queued_s(child):
            os.kill(child, signal.SIGKILL)
            killed = True
        time.sleep(0.002)


def _queued_s(child: int) -> float:
    """How long [s] a process was ready and had no processor: a busy computer's time, not a hang."""
    try:
        return int(Path(f'/proc/{child}/schedstat').read_text(encoding='ascii').split()[1]) * 1e-9
    except (OSError, IndexError):
        return 0.0


def judge(outcome: Outcome, size: int) -> str:
    """What is wrong with a run on an input of ``size`` bytes; empty: nothing.

    Where code of the user's own was run Python's warnings about it are his to see.
    """
    if '.py' in ' '.join(outcome.argv):
        outcome = replace(outcome, err=PYTHON_WARNING.sub('', outcome.err))
    if outcome.status == -signal.SIGXCPU and PROGRESS.search(outcome.err) and outcome.memory <= MEMORY:
        return ''     # it was asked for long work, and shows how far it is
    if outcome.status < 0:
        return f'ended by signal {-outcome.status} after {outcome.cpu_s:.0f} s and {outcome.memory >> 20} MiB'
    if 'Traceback' in outcome.err or outcome.status not in STATUSES:
        return f'status {outcome.status}: {outcome.err.strip()[-300:]}'
    if outcome.memory > max(MEMORY, 10 * size):
        return f'took {outcome.memory >> 20} MiB'
    if '\x1b' in outcome.out + outcome.err:
        return 'an escape sequence reached the terminal'
    if outcome.status == 2:
        lines = outcome.err.strip().splitlines()
        if len(lines) != 1 or not lines[0].startswith('stepdiag: '):
            return f'status 2 with {len(lines)} lines: {outcome.err.strip()[-300:]}'
    elif 'Warning' in outcome.err:
        return f'a warning of a library: {outcome.err.strip()[-300:]}'
    if outcome.status == 0 and '--json' in outcome.argv:
        return _bad_json(outcome.out)
    return ''


def _bad_json(text: str) -> str:
    def refuse(word: str) -> None:
        raise ValueError(f'{word} is not JSON')
    try:
        json.loads(text, parse_constant=refuse)
    except ValueError as error:
        return f'no valid JSON: {error}'
    return ''
