"""Where a log and its simulator disagree, which cause explains it, and how far the gap closes.

Diagnoses each bag and writes DIR/<bag name>/gap.json and index.html, a page that says what is
wrong with the machine.  Several bags are done one after the other, or --jobs at a time; one that
cannot be read costs one line and status 2, the others are still done.  A log that shows a mistake of commissioning
(a sign, a unit, exchanged axes) is not diagnosed: the answer names the mistake.

  stepdiag gap bags/demo
  stepdiag gap logs/* --out diagnoses --jobs 2
  stepdiag gap bags/demo --cell cells/demo.yaml --adopt cells/demo_with_backlash.yaml
  stepdiag gap bags/demo --effect my_effect.py --json
  stepdiag gap bags/demo --further bags/demo_once_more
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import reduce
from multiprocessing import get_context
from pathlib import Path

from stepdiag_ros.cli.progress import Bar
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits, strict_yaml
from stepdiag_ros.guard.files import read_text, real
from stepdiag_ros.guard.jsontext import to_json

NAME = 'gap'
HELP = 'where log and simulator disagree, why, and how far it closes'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bags', metavar='BAG', nargs='+', help='rosbag2 folder or .mcap file')
    parser.add_argument('--cell', metavar='CELL.yaml', type=Path,
                        help='the simulator that the logs are held against: its effects count as known, '
                             'and --adopt starts from it')
    parser.add_argument('--out', metavar='DIR', type=Path, default=Path('gap'),
                        help='folder for the answers and pages (default: ./gap)')
    parser.add_argument('--effect', metavar='FILE.py', action='append', default=[],
                        help='Python file with an effect of your own; it is run, so give only files that you '
                             'trust; may be given several times')
    parser.add_argument('--further', metavar='BAG', action='append', default=[],
                        help='what was measured on the same machine afterwards, as the page recommends: '
                             'diagnosed as one log (one bag only; may be given several times)')
    parser.add_argument('--json', action='store_true',
                        help='print gap.json (of several bags: an object by name)')
    parser.add_argument('--adopt', metavar='NEW_CELL.yaml', type=Path,
                        help='write a cell file with the errors and effects found (one bag only)')
    parser.add_argument('--explain', action='store_true',
                        help='list every set of causes that was weighed: its evidence, its prior probability, and why '
                             'one may not be claimed')
    parser.add_argument('--jobs', metavar='N', type=int, default=1, help='bags at a time (default: 1)')
    parser.add_argument('--namespace', help="the machine's namespace where a log holds several")


@dataclass(frozen=True)
class Job:
    """One bag to diagnose, in a form that goes to another process."""

    bag: str
    name: str
    out: Path
    cell: Path | None
    effects: tuple[str, ...]
    adopt: Path | None
    namespace: str | None
    further: tuple[str, ...] = ()
    explain: bool = False


@dataclass(frozen=True)
class Outcome:
    """What came of a bag: ``document`` (gap.json) and ``text``, or the ``error`` in one line."""

    name: str
    document: dict | None = None
    text: str = ''
    error: str = ''


def run(args: argparse.Namespace) -> int:
    from stepdiag_ros.effects import all_effects

    if args.jobs < 1:
        raise StepdiagError(f'--jobs is {args.jobs}; give 1 or more')
    if args.adopt is not None and len(args.bags) > 1:
        raise StepdiagError('--adopt writes the cell of one log; give one bag')
    if args.further and len(args.bags) > 1:
        raise StepdiagError('--further belongs to one log; give one bag')
    all_effects(args.effect)    # a file that cannot be used is reported before the work begins
    if args.cell is not None:
        from stepdiag_ros.virtual.cell import load_cell
        load_cell(args.cell)
    jobs = [Job(bag, name, args.out / name, args.cell, tuple(args.effect), args.adopt, args.namespace,
                tuple(args.further), args.explain)
            for bag, name in zip(args.bags, _names(args.bags), strict=True)]
    bar = Bar('gap', quiet=not sys.stderr.isatty())
    outcomes: dict[str, Outcome] = {}
    for outcome in _work(jobs, args.jobs, bar):
        outcomes[outcome.name] = outcome
        if outcome.error:
            bar.say(f'stepdiag: {outcome.error}') if sys.stderr.isatty() else \
                print(f'stepdiag: {outcome.error}', file=sys.stderr)
        elif not args.json:
            bar.close()
            print(outcome.text + '\n', flush=True)
        bar.show(len(outcomes), len(jobs), outcome.name)
    bar.close()
    if args.json:
        documents = {job.name: outcomes[job.name].document for job in jobs
                     if outcomes[job.name].document is not None}
        if len(jobs) > 1 or documents:
            shown = documents if len(jobs) > 1 else next(iter(documents.values()))
            print(to_json(shown))
    return 2 if any(o.error for o in outcomes.values()) else 0


def _names(bags: list[str]) -> list[str]:
    """A name for each bag, as the folder of its answer; of equal ones the later get a number."""
    names: list[str] = []
    for bag in bags:
        path = real(bag)
        base = path.stem if path.suffix == '.mcap' else path.name
        name, number = base, 2
        while name in names:
            name, number = f'{base}_{number}', number + 1
        names.append(name)
    return names


def _work(jobs: list[Job], at_a_time: int, bar: Bar):
    """Outcomes as they come."""
    if at_a_time == 1 or len(jobs) == 1:
        for number, job in enumerate(jobs):
            bar.show(number, len(jobs), job.name)
            yield diagnose_bag(job)
        return
    # Fresh processes: numerical libraries with threads do not survive a fork.
    with ProcessPoolExecutor(min(at_a_time, len(jobs)), get_context('spawn')) as pool:
        bar.show(0, len(jobs))
        for future in as_completed([pool.submit(diagnose_bag, job) for job in jobs]):
            yield future.result()


def diagnose_bag(job: Job) -> Outcome:
    """Read, diagnose, write; bad input becomes a line."""
    try:
        return _diagnose_bag(job)
    except StepdiagError as error:
        return Outcome(job.name, error=str(error))
    except (ArithmeticError, ValueError, MemoryError) as error:
        # Numbers that no check caught, numpy.linalg's errors among them: the other bags are still done.
        return Outcome(job.name, error=f'{job.bag}: cannot be diagnosed: {type(error).__name__}: {error}; look at the '
                                       f'bag with `stepdiag info {job.bag}`')


def _diagnose_bag(job: Job) -> Outcome:
    from stepdiag_ros.bag.reader import read_log
    from stepdiag_ros.effects import all_effects
    from stepdiag_ros.gap.diagnose import diagnose
    from stepdiag_ros.gap.summary.explain import table
    from stepdiag_ros.model.joined import joined
    from stepdiag_ros.report.gap_page import gap_page
    from stepdiag_ros.report.gap_words import summary
    from stepdiag_ros.report.series import replayed
    from stepdiag_ros.virtual.acting import allow_effect_files

    allow_effect_files(job.effects)
    logs, known = [], ()
    for bag in (job.bag, *job.further):
        log = read_log(bag, job.namespace)
        if job.cell is not None:
            from stepdiag_ros.twin.against import without_known
            log, known = without_known(log, job.cell, logs[0] if logs else None)
        logs.append(log)
    log = reduce(joined, logs)
    insane = _insane(job, log)
    if insane is not None:
        return insane
    diagnosis = diagnose(log, [kind() for kind in all_effects(job.effects).values()])
    notes: tuple[str, ...] = known
    again = None
    if job.adopt is not None:
        adopted = _adopt(job, diagnosis)
        notes += (f'cell written to {job.adopt}', *adopted.notes)
        again = replayed(diagnosis, adopted.made, adopted.left)
    document = diagnosis.to_json_dict()
    _write(job, document, gap_page(diagnosis, job.name, notes, again))
    text = summary(diagnosis, job.name, notes) + f'\n  page: {job.out / "index.html"}'
    if job.explain:
        text += f'\n\n{table(diagnosis.weighed)}'
    return Outcome(job.name, document, text)


def _insane(job: Job, log) -> Outcome | None:
    """What there is to say of a log that shows a mistake of commissioning, in place of a diagnosis; None of others."""
    from html import escape

    from stepdiag_ros.estimate.sanity_fit import mistakes
    from stepdiag_ros.report.page import page

    found = mistakes(log)
    if not found:
        return None
    document = {'verdict': 'unexplained', 'gap': None, 'where': [], 'effects': [], 'indistinguishable': [],
                'next_measurement': None, 'sanity': [finding.to_json_dict() for finding in found]}
    title = f'{job.name}: the log is not sane'
    body = f'<h1>{escape(title)}</h1><p>Nothing is diagnosed before this is put right.</p><ul>'
    body += ''.join(f'<li>{escape(str(finding))}.</li>' for finding in found) + '</ul>'
    _write(job, document, page(title, body))
    text = '\n'.join([f'{title}; nothing is diagnosed before this is put right', *(f'  {f}' for f in found),
                      f'  page: {job.out / "index.html"}'])
    return Outcome(job.name, document, text)


def _write(job: Job, document: dict, whole_page: str) -> None:
    """gap.json and the page of one bag."""
    try:
        job.out.mkdir(parents=True, exist_ok=True)
        (job.out / 'gap.json').write_text(to_json(document), encoding='utf-8')
        (job.out / 'index.html').write_text(whole_page, encoding='utf-8')
    except OSError as error:
        raise StepdiagError(f'{job.out}: cannot be written: {error.strerror or error}; '
                            'name another folder with --out') from None


def _adopt(job: Job, diagnosis):
    import yaml

    from stepdiag_ros.twin.adopt import adopt

    base = None
    if job.cell is not None:
        base = strict_yaml.load(read_text(job.cell, limits.YAML_BYTES, 'cell file'), str(job.cell))
    adopted = adopt(diagnosis, base)
    head = f'# Cell as found in {job.name} by `stepdiag gap --adopt`.\n'
    head += ''.join(f'# {note}\n' for note in adopted.notes)
    try:
        job.adopt.write_text(head + yaml.safe_dump(adopted.cell, sort_keys=False, default_flow_style=None,
                                                   width=110), encoding='utf-8')
    except OSError as error:
        raise StepdiagError(f'{job.adopt}: cannot be written: {error.strerror or error}') from None
    return adopted
