"""What ``stepdiag calibrate --until-settled`` prints of each further run and of the answer."""

from collections.abc import Mapping

from stepdiag_ros.gap.experiment_design.extended_log import Run
from stepdiag_ros.nodes.settling import NOTHING_HELPS, TIME_IS_UP, Round, Settled
from stepdiag_ros.report.gap_words import headline
from stepdiag_ros.report.words import percent, title

MOST_ODDS = 10_000


def round_line(number: int, one: Round) -> str:
    """What is open, which run is made and why, how long it takes."""
    odds = 1.0 / max(one.able.run.error, 1e-300)
    promise = f'more than {MOST_ODDS}' if odds > MOST_ODDS else f'{float(f"{odds:.2g}"):g}'
    return (f'further run {number}: open: {open_words(one.open)}. '
            f'The cell {run_words(one.able.code, one.able.run.run)}; expected to decide with odds of {promise} '
            f'to one; takes about {span(one.able.seconds)}; log: {one.bag}')


def open_words(names: Mapping[str, float]) -> str:
    """What is left open with its probabilities: ``A (62 %), B (38 %)``."""
    return ', '.join(f'{title(name)} ({percent(p)})'
                     for name, p in names.items())


def run_words(code: str, run: Run) -> str:
    """What the cell does: ``waits 2 min, mounts ppp and measures it``."""
    said = f'waits {span(run.wait)}, ' if run.wait else ''
    said += f'mounts {code}'
    said += f', records it for {span(run.watch)} before it moves,' if run.watch else ''
    said += ' and measures it' + ('' if run.known else ', which the log does not hold')
    if run.again_after is not None:
        said += f', and again {"after " + span(run.again_after) if run.again_after else "at once"}'
    return said


def answer_words(settled: Settled, time_s: float) -> str:
    """The final answer in one line or two."""
    runs = len(settled.rounds)
    after = f'after {runs} further run{"s" if runs > 1 else ""}' if runs else 'without a further run'
    if settled.sure:
        return f'settled {after}: {headline(settled.diagnosis)}'
    left = f'left open {after}: {open_words(settled.open)}. '
    if settled.how == TIME_IS_UP and settled.wanted is not None:
        left += (f'Time is up: the next run ({run_words(settled.wanted.code, settled.wanted.run.run)}) takes about '
                 f'{span(settled.wanted.seconds)}, more than is left of --settle-time {time_s:g} s.')
    elif settled.how == NOTHING_HELPS:
        left += 'No run that this cell makes without hands is expected to decide.'
        if settled.diagnosis.next_measurement:
            left += f' By hand: {settled.diagnosis.next_measurement}'
    elif settled.outcome is not None:
        left += f'The further run was {settled.outcome.how}: {settled.outcome.message}.'
    return f'{left}\n{headline(settled.diagnosis)}'


def span(seconds: float) -> str:
    """A duration in s or min."""
    return f'{seconds:.0f} s' if seconds < 120.0 else f'{seconds / 60.0:.0f} min'
