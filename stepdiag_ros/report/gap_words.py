"""A diagnosis in sentences: the verdict, each cause with its size, the text summary of the command."""

from dataclasses import replace

import numpy as np

from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import CONFUSED
from stepdiag_ros.gap.diagnosis import AXIS_LIKE, Diagnosis, Found
from stepdiag_ros.gap.inference.search import NOTHING
from stepdiag_ros.gap.summary.cross_validation import CrossValidation, Distance, cross_validated
from stepdiag_ros.gap.summary.margins import AT_REST, MOVING, SETTLING
from stepdiag_ros.gap.summary.volume import VolumeChange
from stepdiag_ros.model.machine import CURVES, SQUARENESS
from stepdiag_ros.report.pattern_words import pattern_words
from stepdiag_ros.report.series import reach
from stepdiag_ros.report.words import (
    SHORT_CHANNELS,
    certainty,
    closed_percent,
    micrometres,
    parameter_name,
    parameter_unit,
    percent,
    plain,
    quantity,
    scale,
    title,
)

AMONG_KNOWN = ('How sure is meant among the causes that are known here. Of what nobody had thought of, one in four was '
               'given one of these names, as sure as this (blind checks, 53 of 188): where the shop floor contradicts '
               'a name, believe the shop floor and measure again.')
"""What a probability cannot say; the four sealed sets of kinds that nobody had looked into (docs/blind-check.md)."""
ALTERNATIVE = 0.05
"""Probability from which a headline names what may act instead."""
SIGNIFICANT = 3.0
"""A size is named in a sentence from this many standard deviations on."""
SPEAKING = ('angle', 'jump', 'both', 'all')
"""Names of parameters longer than a letter or two that a sentence can take as they are."""
LEAST_REACH_M = 1e-9
NAMED = 3
"""Most sizes in a sentence."""
HARDLY = 1.15
"""Reduced χ² of the held-out part up to which a gap does not stand out of the noise there."""
NOISE_LIKE = 1.3
"""Reduced χ² of the held-out part up to which the residual counts as noise."""
LEAST_CLOSED = 0.1
"""Share of a gap that must be gone on what was held out before structure is said to bring it down."""
SETTINGS = {'path': 'along the path', 'reversal': 'along the path, opposite on the way back', 'time': 'in time'}
"""What a band is along, in words."""
STATES = {MOVING: 'while the axes move (stamps)', SETTLING: 'inside the stops (settling, shaking)',
          AT_REST: 'at rest (means of the stops)'}
"""The states of the machine in which a gap shows, in words."""
NOT_METRES = ('Have the index of air recorded (environment topics), or give air: in the cell file; until then neither '
              'this log nor what follows from it can tell what the positioning errors are, by some 270 µm a metre.')
JOIN = 'Record it in a bag of its own; “stepdiag gap BAG --further NEW_BAG” then diagnoses both as one log.'
"""How a further run comes to bear."""


def sizes(found: Found) -> list[tuple[str, str]]:
    """All parameters of a cause: name and value ± σ with unit."""
    rows = []
    for name, value in found.parameters.items():
        unit = parameter_unit(name, found.units)
        if name in ('run', 'index') or name.startswith(('run (', 'index (')):
            # Which run and stop: said by the form's label, a number says nothing.
            continue
        text = quantity(value, unit, found.sigma.get(name))
        if unit == '1/m' and value and found.sigma.get(name):
            text = f'{value * 1e6:.3g} ± {found.sigma[name] * 1e6:.1g} /km (radius {abs(1.0 / value):.3g} m)' \
                .replace('/km', '·10⁻⁶/m')
        rows.append((parameter_name(name), text))
    return rows


def size_words(found: Found) -> str:
    """The largest sizes that count: ``X 5.71 ± 0.12 µm, Y 5.15 ± 0.11 µm, k = 1``."""
    known = {name: (value, found.sigma[name]) for name, value in found.parameters.items() if name in found.sigma}
    counted = [(abs(value), name) for name, (value, sigma) in known.items()
               if _speaks(name) and abs(value) > SIGNIFICANT * sigma > 0.0]
    counted.sort(reverse=True)
    chosen = [name for _, name in counted[:NAMED]]
    said = [f'{parameter_name(n)} {quantity(value, parameter_unit(n, found.units), sigma)}'
            for n, (value, sigma) in known.items() if n in chosen]
    return ', '.join([*said, 'k = 1']) if said else ''


def _speaks(name: str) -> bool:
    """Whether a sentence can take a parameter's name as it is: an axis, a unit in it, a plain word."""
    return len(name) < AXIS_LIKE or name.endswith(('_s', '_Hz', '_m')) or name in SPEAKING


def cause(diagnosis: Diagnosis, found: Found) -> str:
    """One cause in a clause, with its size: its parameters where they speak for themselves, else what
    it does to the readings."""
    size = size_words(found) or reach_words(diagnosis, found.name)
    return (found.title.rstrip('.') or title(found.name)) + (f' ({size})' if size else '')


def reach_words(diagnosis: Diagnosis, name: str) -> str:
    """How far a cause moves the readings at most; empty where it leaves the stops' means alone."""
    length, spot = reach(diagnosis, name)
    parts = []
    if length > LEAST_REACH_M:
        parts.append(f'the laser length by up to {quantity(length, "m")}')
    if spot > LEAST_REACH_M:
        parts.append(f'the spot by up to {quantity(spot, "m")}')
    return ' and '.join(parts)


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in one sentence."""
    found, unmodelled = diagnosis.effects, pattern_words(diagnosis.unmodelled)
    floor = micrometres(diagnosis.cross_validation.floor_m)
    if not found and not diagnosis.unmodelled:
        said = (f'Nothing is wrong that this log could show: machine and simulator agree as closely as '
                f'noise lets them ({floor})')
        return f'{said}, but for a hint of {_hinted(diagnosis)}.' if diagnosis.hint else f'{said}.'
    names = stand_ins(diagnosis)
    if not found and names:
        return (f'Something disturbs the measurement to which this log gives no sure name: {unmodelled}. '
                f'What would look the same: {" or ".join(_lower(title(name)) for name in names)}.')
    if not found:
        return f'Something disturbs the measurement that is none of the known causes: {unmodelled}.'
    alone = sum(weight for names, weight in diagnosis.sets if names == (UNKNOWN,))
    if diagnosis.unmodelled and alone > ALTERNATIVE:
        said = ' and '.join(f'{_lower(cause(diagnosis, f))} ({percent(f.probability)})' for f in found)
        return (f'Something acts that is none of the known causes: {unmodelled}. Whether besides it {said}, or one '
                'cause that has no name does all of it, this log does not tell.')
    if len(found) == 1:
        text = cause(diagnosis, found[0])
        others = alternatives(diagnosis, found[0])
        if others:
            said = [f'{_lower(title(name)) if name != UNKNOWN else "unmodelled structure"} ({percent(p)})'
                    for name, p in others]
            text = f'Either: {_lower(text)} ({percent(found[0].probability)}) — or {" or ".join(said)}'
    else:
        count = {2: 'Two', 3: 'Three', 4: 'Four'}.get(len(found), str(len(found)))
        text = f'{count} things act together: ' + '; '.join(
            f'{i}) {_lower(cause(diagnosis, f))}' for i, f in enumerate(found, 1))
    if diagnosis.unmodelled:
        return f'{text} — and something more that is none of the known causes: {unmodelled}.'
    return text + '.'


def how_sure(diagnosis: Diagnosis) -> str:
    """How sure the verdict is: each cause's probability, or that of nothing; in a sentence."""
    if diagnosis.effects:
        said = '; '.join(f'{title(f.name)}: {certainty(f.probability)} ({percent(f.probability)})'
                         for f in diagnosis.effects)
        return f'{said}.' + (' What else is there has no name.' if diagnosis.unmodelled else '')
    if diagnosis.unmodelled:
        known = max((p for name, p in diagnosis.ranking.items() if name not in (UNKNOWN, NOTHING)), default=0.0)
        there = 1.0 - diagnosis.ranking.get(NOTHING, 0.0)
        return (f'That something is there: {certainty(there)} ({percent(there)}); the likeliest known cause has '
                f'{percent(known)}.')
    sure = diagnosis.ranking.get(NOTHING, 0.0)
    other = max(((p, name) for name, p in diagnosis.ranking.items() if name != NOTHING), default=None)
    return f'{percent(sure)} that nothing acts' + (
        f'; likeliest beside that: “{title(other[1])}” ({percent(other[0])}).' if other else '.')


def what_to_do(diagnosis: Diagnosis) -> str:
    """What to do about it: the remedies, the next measurement; in sentences."""
    said = [f.remedy for f in diagnosis.effects if f.remedy]
    if diagnosis.untold:
        said.append(NOT_METRES)
    said = [f'{i}) {text}' for i, text in enumerate(said, 1)] if len(said) > 1 else said
    if diagnosis.next_measurement:
        said.append(f'Measure next: {diagnosis.next_measurement}')
    if not said and not diagnosis.effects and not diagnosis.unmodelled:
        return 'Nothing that this log asks for.'
    return ' '.join(said) or 'Look at the pictures below: when and where it shows tells what to look for.'


def correlates_words(diagnosis: Diagnosis) -> str:
    """What an unmodelled structure correlates with; '' where nothing stands out."""
    said = [f'{one.quantity} ({SHORT_CHANNELS[one.channel]}, {closed_percent(one.share)})'
            for one in diagnosis.correlates]
    return f'It correlates with {", ".join(said)}: share of its variance at the stops that one alone would follow.' \
        if said else ''


def separation_words(diagnosis: Diagnosis, group: tuple[str, ...]) -> str:
    """How well the log separates what is indistinguishable in it."""
    said = [f'{np.exp(behind):.2g} to one against “{title(name)}”'
            for name, behind in sorted(diagnosis.separation.items(), key=lambda item: item[1]) if name in group]
    return f'The evidence is {", ".join(said)}; it takes {np.exp(CONFUSED):.2g} to one to decide.' if said else ''


def hint_words(diagnosis: Diagnosis) -> str:
    """How much speaks for what nothing is claimed of; '' where there is no such thing."""
    if not diagnosis.hint:
        return ''
    found = diagnosis.hint.found
    times, enough = (f'{float(f"{np.exp(log):.2g}"):.0f}' for log in (found.log_bayes, found.claimed_from))
    return (f'With {_hinted(diagnosis)} the log is {times} times as likely as without. That is a hint, not a finding: '
            f'a finding takes {enough} times, for probabilities take the noise to be just as thought, and it never '
            'quite is.')


def _hinted(diagnosis: Diagnosis) -> str:
    """What a hint points to: each cause, with those that it may be taken for."""
    said = []
    for name, form in diagnosis.hint.forms.items():
        others = [n for group in diagnosis.indistinguishable if name in group for n in group if n != name]
        first = f'unmodelled structure ({pattern_words(form)})' if name == UNKNOWN else f'“{title(name)}”'
        said.append(' or '.join([first, *(f'“{title(n)}”' for n in others)]))
    return ' and '.join(said)


def alternatives(diagnosis: Diagnosis, found: Found) -> list[tuple[str, float]]:
    """What may act instead of the only cause found, with the probabilities, the likeliest first; nothing, where the log
    leaves it less than one in twenty."""
    claimed = {f.name for f in diagnosis.effects}
    return [(name, p) for name, p in sorted(diagnosis.ranking.items(), key=lambda item: -item[1])
            if name not in claimed and name != NOTHING and p > ALTERNATIVE and found.probability < 1.0 - ALTERNATIVE]


def stand_ins(diagnosis: Diagnosis) -> list[str]:
    """The known causes that unmodelled structure may as well be."""
    return [name for group in diagnosis.indistinguishable if UNKNOWN in group for name in group if name != UNKNOWN]


def _lower(text: str) -> str:
    keeps = text[:2].isupper() and not text.startswith('A ')
    return text if keeps else text[0].lower() + text[1:]


def closed_share(diagnosis: Diagnosis) -> float | None:
    """Share of the gap's variance above the floor that is gone; None where there was none."""
    gap = diagnosis.cross_validation
    return 1.0 - gap.gap.left if gap.before_m > gap.floor_m else None


def how_far(diagnosis: Diagnosis) -> str:
    """Before, after and the floor in a sentence."""
    gap = diagnosis.cross_validation
    if diagnosis.verdict == 'no_gap':
        return (f'On {gap.held_out}, simulator and machine differ by {micrometres(gap.before_m)}; '
                f'{_expected(gap.gap)}.')
    if diagnosis.unmodelled and not diagnosis.effects and not diagnosis.joint.active:
        return (f'The readings at the stops differ by {micrometres(gap.before_m)} (noise alone, with what it adds: '
                f'{micrometres(gap.floor_m)}); it has no pattern that the simulator could be given.')
    if diagnosis.unmodelled and not diagnosis.effects and (closed_share(diagnosis) or 0.0) < LEAST_CLOSED:
        return _hardly_shows(diagnosis) if gap.before < HARDLY else f'The gap {_stays(gap)}.'
    if diagnosis.unmodelled and not diagnosis.effects:
        return (f'Unmodelled structure brings the gap from {micrometres(gap.before_m)} to '
                f'{micrometres(gap.after_m)} (noise alone: {micrometres(gap.floor_m)}). It describes the trouble; '
                'it does not explain it.')
    if not any(a.effect.name for a in diagnosis.joint.active):
        return (f'The mean readings at the stops differ by {micrometres(gap.before_m)}; '
                f'noise alone makes {micrometres(gap.floor_m)}.')
    if gap.before < HARDLY:
        return _hardly_shows(diagnosis)
    share = closed_share(diagnosis)
    rest = f'the residual is still {gap.after_m / max(gap.floor_m, 1e-300):.1f} times the noise'
    if gap.after < NOISE_LIKE:
        rest = 'the residual is noise' if gap.after_m**2 < NOISE_LIKE * gap.floor_m**2 else \
            f'the residual is noise and the {micrometres(gap.gap.sigma)} by which the prediction itself is uncertain'
    if gap.gap.sigma > gap.floor_m:
        rest = (f'the residual is {gap.after_m / max(gap.floor_m, 1e-300):.1f} times the noise; what was fitted leaves '
                f'the forecast uncertain by {micrometres(gap.gap.sigma)}')
    where = ' of the spot' if gap.channel == 'spot' else ''
    with_it = f'With {"it" if len(diagnosis.effects) == 1 else "them"} in the simulator the gap{where}'
    if (share or 0.0) < LEAST_CLOSED:
        return f'{with_it} {_stays(gap)}; {rest}.'
    return (f'{with_it} falls from {micrometres(gap.before_m)} to {micrometres(gap.after_m)} (noise alone: '
            f'{micrometres(gap.floor_m)}): {closed_percent(share or 0.0)} of it is gone, {rest}.')


def further_words(gap: CrossValidation) -> str:
    """What a further part of the log will show, in a sentence; '' where nothing was held out."""
    of = gap.gap
    if of.after_95 is None or of.closed_95 is None:
        return ''
    part = next((word for word in ('repeat', 'setup') if word in gap.held_out), 'run')
    low, high = (micrometres(limit) for limit in of.after_95)
    gone = '' if of.before == of.after else \
        f', and {closed_percent(of.closed_95[0])} to {closed_percent(of.closed_95[1])} of the gap gone'
    return f'Of a further {part}, predicted from all of these, expect an error of {low} to {high}{gone} (95 %).'


def _hardly_shows(diagnosis: Diagnosis) -> str:
    """That the stops' means hardly tell of what was found, and what does."""
    gap = diagnosis.cross_validation
    still = diagnosis.margins is not None and diagnosis.margins.state[SETTLING] > 0.5
    return (f'In the means of single stops it hardly shows: {micrometres(gap.before_m)} where {_expected(gap.gap)}. '
            + ('It shows in how the readings move while the machine stands still.' if still else
               'It shows in what many stops have in common.'))


def _stays(gap: CrossValidation) -> str:
    """That a gap does not fall on what was held out, in a clause."""
    return (f'stays: {micrometres(gap.before_m)} before and {micrometres(gap.after_m)} after (noise alone: '
            f'{micrometres(gap.floor_m)}), for what was seen in one part of the log does not predict another')


def over_setups_words(diagnosis: Diagnosis) -> str:
    """The same where whole setups are held out; '' of a log of one."""
    over = diagnosis.over_setups
    if over is None:
        return ''
    if not diagnosis.joint.active:
        return (f'Where whole setups are held out, each predicted from the others, they differ by '
                f'{micrometres(over.before_m)} (noise alone: {micrometres(over.floor_m)}; no other setup tells how a '
                'setup\'s own laser and mirror are mounted).')
    held_out = 'Where whole setups are held out, each predicted from the others, the gap'
    if over.before_m**2 < HARDLY * over.floor_m**2:
        return (f'{held_out} hardly shows: {micrometres(over.before_m)} before and {micrometres(over.after_m)} after '
                f'(noise alone: {micrometres(over.floor_m)}).')
    if 1.0 - over.gap.left < LEAST_CLOSED:
        return f'{held_out} {_stays(over)}.'
    return (f'{held_out} falls from {micrometres(over.before_m)} to {micrometres(over.after_m)} (noise alone: '
            f'{micrometres(over.floor_m)}).')


def _expected(gap: Distance) -> str:
    """What a gap would be of nothing but noise and what the prediction does not know [m], in a clause."""
    alone = f'noise alone makes {micrometres(gap.floor)}'
    return alone if gap.sigma < 0.1 * gap.floor else (
        f'{alone}, together with the {micrometres(gap.sigma)} by which the prediction itself is uncertain '
        f'{micrometres(float(np.hypot(gap.floor, gap.sigma)))}')


def closes_words(found: Found) -> str:
    """How much a cause explains of what the fit leaves without it; not what it closes on held-out runs."""
    share = closed_percent(found.closes) if found.closes > 0.005 else 'less than 1 %'
    return f'in the fit takes away {share} of what exceeds the noise'


def steps(diagnosis: Diagnosis) -> list[tuple[str, float]]:
    """The gap budget: label and gap [m] on the held-out part, from before over each cause to after."""
    gap, joint = diagnosis.cross_validation, diagnosis.joint
    rows = [('before', gap.before_m)]
    names = [name for name in dict.fromkeys(f.name for f in diagnosis.effects)
             if any(a.effect.name == name for a in joint.active)]
    if any(not a.effect.name for a in joint.active):
        names.append('')
    taken: list[str] = []
    for i, name in enumerate(names):
        taken.append(name)
        if i == len(names) - 1:
            value = gap.after_m
        else:
            part = tuple(a for a in joint.active if a.effect.name in taken)
            value = cross_validated(replace(joint, active=part)).after_m
        rows.append((name or 'unknown', value))
    return rows


def changes(before: Solution, after: Solution) -> list[tuple[str, float, float]]:
    """Errors by how much taking the causes out moves them: name, largest change [m or rad], its size in σ.

    ``before``, ``after``: solutions without and with the causes.
    """
    rows = []
    for name in CURVES:
        if before.has(name) and after.has(name):
            difference = after.curve(name)[1] - before.curve(name)[1]
            worst = int(np.argmax(np.abs(difference)))
            rows.append((name, float(difference[worst]), after.curve(name)[2][worst]))
    for name in SQUARENESS:
        if before.has(name) and after.has(name):
            rows.append((name, after.squareness(name)[0] - before.squareness(name)[0],
                         after.squareness(name)[1]))
    rows = [(name, change, abs(change) / sigma if sigma > 0 else 0.0) for name, change, sigma in rows]
    return sorted(rows, key=lambda row: -row[2])


def volume_words(change: VolumeChange) -> str:
    """What taking the causes out changes of the volumetric error."""
    at = ', '.join(f'{letter} {1e3 * place:.0f}' for letter, place in zip('XYZ', change.at, strict=True))
    return ('In the working volume the predicted place of the tool changes by up to '
            f'{quantity(change.largest, "m", change.sigma)} (at {at} mm), {quantity(change.rms, "m")} r.m.s.')


def bands_words(diagnosis: Diagnosis) -> str:
    """Which bands of frequency stand out of the noise, and whether any does afterwards, in a sentence."""
    loud = [band for band in diagnosis.bands if band.stands_out]
    if not loud:
        return f'None of {len(diagnosis.bands)} bands, along the path and in time, stands out of the noise by itself.'
    most = max(loud, key=lambda band: band.before)
    periods = period_words(most.shortest, most.longest, most.unit)
    return (f'{len(loud)} of {len(diagnosis.bands)} bands stand out of the noise, most the '
            f'{SHORT_CHANNELS[most.channel]} with periods of {periods} {SETTINGS[most.setting]}: '
            f'{plain(np.sqrt(most.before))} times the noise, {plain(np.sqrt(most.after))} times afterwards.')


def period_words(shortest: float, longest: float, unit: str) -> str:
    """``38.0 … 75.0 mm``."""
    divisor, said = scale(unit, longest)
    begin = f'{plain(shortest / divisor)} … ' if longest > shortest else ''
    return f'{begin}{plain(longest / divisor)} {said}'


def where_words(diagnosis: Diagnosis) -> str:
    """Where the gap lies, in a sentence."""
    if diagnosis.only_stamps:
        return 'In what is read while the axes move; while they stand still a wrong stamp changes nothing.'
    shares = diagnosis.shares
    if not shares:
        return 'Nowhere: no part of the log stands out of the noise.'
    parts = []
    for channel, said in SHORT_CHANNELS.items():
        mine = [s for s in shares if s.channel == channel]
        if not mine:
            continue
        names = ', '.join(dict.fromkeys(s.setup for s in mine if s.setup))
        text = f'{closed_percent(sum(s.share for s in mine))} in the {said}'
        if names:
            text += f' ({names})'
        axes = {s.axis for s in mine}
        directions = {s.direction for s in mine}
        if len(axes) == 1 and None not in axes:
            text += f' after moves of {axes.pop()}'
        if len(directions) == 1 and None not in directions:
            text += ' going ' + ('forward' if directions.pop() > 0 else 'backward')
        parts.append(text)
    states = diagnosis.margins.state if diagnosis.margins else {}
    if states.get(SETTLING, 0.0) > 0.5:
        parts.append(f'{closed_percent(states[SETTLING])} of all of it shows while the machine stands still at a stop')
    if states.get(MOVING, 0.0) > 0.0:
        parts.append('beside this, wrong stamps show while the axes move')
    return '; '.join(parts) + '.'


def summary(diagnosis: Diagnosis, name: str, adoption: tuple[str, ...] = ()) -> str:
    """What the command prints of one log."""
    lines = [f'{name}: {headline(diagnosis)}', f'  {how_far(diagnosis)}']
    if further := further_words(diagnosis.cross_validation):
        lines.append(f'  {further}')
    if diagnosis.untold:
        lines += ['', f'  The lengths are {diagnosis.untold}', f'  {NOT_METRES}']
    for found in diagnosis.effects:
        lines.append('')
        lines.append(f'  {title(found.name)} [{found.name}]: {certainty(found.probability)} '
                     f'({percent(found.probability)}), {closes_words(found)}')
        rows = sizes(found)
        width = max(len(n) for n, _ in rows) if rows else 0
        lines += [f'      {n:<{width}}  {text}' for n, text in rows[:8]]
        if len(rows) > 8:
            lines.append(f'      … and {len(rows) - 8} more in gap.json')
        moved = reach_words(diagnosis, found.name)
        if moved:
            lines.append(f'      moves {moved}')
        if found.remedy:
            lines.append(f'      What to do: {found.remedy}')
    if any('±' in text for found in diagnosis.effects for _, text in sizes(found)):
        lines += ['', '  Sizes ± one standard uncertainty (k = 1).']
    if diagnosis.hint:
        lines += ['', f'  {hint_words(diagnosis)}']
    if diagnosis.unmodelled:
        more = f'{pattern_words(diagnosis.unmodelled)}. {correlates_words(diagnosis)}'
        lines += ['', f'  Not explained: {more}'.rstrip()]
    if diagnosis.shares:
        lines += ['', f'  Where: {where_words(diagnosis)}']
    for group in diagnosis.indistinguishable:
        lines += ['', '  Indistinguishable in this log: ' + ' / '.join(title(n) for n in group)
                  + f'. {separation_words(diagnosis, group)}'.rstrip()]
    if diagnosis.next_measurement:
        lines += [f'  Measure next: {diagnosis.next_measurement}']
        lines += [f'    {JOIN}'] if diagnosis.next_run or diagnosis.hint else []
    lines += [f'  note: {text}' for text in (*diagnosis.warnings, *adoption) if text != diagnosis.untold]
    return '\n'.join(lines)
