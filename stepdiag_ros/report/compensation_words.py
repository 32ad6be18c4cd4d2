"""What tables do, in words: the lines of the command and the README beside the tables."""

from stepdiag_ros.compensate.approach import Reversal
from stepdiag_ros.compensate.compensation import Compensation
from stepdiag_ros.estimate.prediction import Prediction
from stepdiag_ros.estimate.traceability import WORDS

LEAST_SAID_M = 0.5e-6
"""What a kind of table leaves of an error is named from this size on."""


def _figure(found: Compensation, prediction: Prediction) -> str:
    size, spread, place = found.worst(prediction)
    at = ', '.join(f'{1e3 * c:.0f}' for c in place)
    return f'{1e6 * size:.2f} µm, U = {1e6 * spread:.2f} µm (95 %), at ({at}) mm of the volume'


def _small(value: float) -> str:
    """Two digits behind the point, or two that are not zero."""
    return f'{value:.2f}' if value >= 0.1 else f'{value:.2g}'


def reversal_words(reversal: Reversal) -> str:
    """Lost motion of the axes with its U."""
    return ', '.join(f'{axis} {1e6 * value:.2f} µm, U = {_small(1e6 * spread)} µm (k = 2)'
                     for axis, (value, spread) in reversal.items())


def summary(found: Compensation) -> str:
    """The numbers for people."""
    tool = ', '.join(f'{1e3 * c:.1f}' for c in found.point.tool)
    line = ', '.join(f'{1e3 * c:.1f}' for c in found.point.line + found.place.origin)
    where = 'whole volume' if found.whole_volume else 'on the line that was measured; rotations are not known'
    lines = [f'{found.control.title} for machine {found.place.machine.name}',
             f'  functional point   tool ({tool}) mm' + (
                 '' if found.control.whole_model else f', lines through ({line}) mm in machine coordinates'),
             f'  largest deviation  now        {_figure(found, found.before)}',
             f'                     predicted  {_figure(found, found.after)}; {where}',
             f'                     to be measured  {_figure(found, found.as_measured)}, from its own reference lines']
    if found.line_alone is not None:
        share, most = found.worse_alone()
        lines.append(f'  held back          the tables of the line alone would leave '
                     f'{_figure(found, found.line_alone)}, and make '
                     f'{100.0 * share:.2g} % of the places worse beyond their U by repeats (k = 2), by up to '
                     f'{1e6 * most:.1f} µm')
    rest = {name: value for name, value in found.not_carried.items() if value >= LEAST_SAID_M}
    if rest:
        lines.append('  cannot be carried  by this kind of table, largest in the volume, ± U (k = 2): ' + ', '.join(
            f'{name} {1e6 * value:.1f} ± {1e6 * found.not_carried_spread[name]:.1f} µm'
            for name, value in sorted(rest.items(), key=lambda item: -item[1])))
    for reversal, what in ((found.reversal, 'half of it in each direction'),
                           (found.reversal_left, 'it stays, this kind of table knows no direction; give it to the '
                                                 "control's own backlash compensation")):
        if reversal:
            lines.append(f'  reversal           {reversal_words(reversal)}: {what}; the largest deviation counts it '
                         'from the worst side')
    tied = found.solution.traceability
    if tied is not None:
        lines.append(f'  errors             {WORDS[tied.air]}; {tied.temperature_words}')
        lines.append(f'  parts              {tied.workpiece_words}')
    if found.left_out:
        lines.append(f'  left out           {", ".join(found.left_out)}: the log leaves them open; they count in each '
                     'U of a largest deviation, and in no value')
    if found.unmeasured:
        lines.append(f'  not measured       {", ".join(found.unmeasured)}: no tables of them')
    return '\n'.join(lines)


def readme(found: Compensation, log: str) -> str:
    """The text beside the tables: what is not confirmed first, then numbers, loading, the way back."""
    question = found.control.open_question
    first = f'NOTE: {question}.' if question else f'Signs and units: {found.control.source}.'
    return '\n'.join([
        first, '', f'Tables from the log {log}, by `stepdiag compensate`.', '', summary(found), '',
        f'Signs and units follow: {found.control.source}.', '',
        f'To load: {found.control.load}', '',
        f'The way back: {found.control.undo} The folder before/ holds what the control held according to --present; '
        'for a file that was not given there is a table of zeros.', '',
        'Then measure again and let `stepdiag verify BEFORE AFTER --prediction prediction.json --tolerance …` decide.',
        ''])
