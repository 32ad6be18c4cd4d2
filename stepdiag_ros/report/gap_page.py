"""The page of a diagnosis: what is wrong with the machine, for someone who knows machines."""

from collections.abc import Callable
from datetime import UTC, datetime
from html import escape

import numpy as np

from stepdiag_ros.estimate.traceability import NOBODY, WORDS
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import LEAST_SHARE
from stepdiag_ros.gap.diagnosis import Diagnosis, Found
from stepdiag_ros.gap.summary.bands import Band
from stepdiag_ros.gap.summary.margins import SETTLING, Margins
from stepdiag_ros.model.description import Description
from stepdiag_ros.report import gap_figures, gap_words
from stepdiag_ros.report.page import bars, figure, page, table
from stepdiag_ros.report.pattern_words import pattern_words
from stepdiag_ros.report.series import Series, inside, series, spectra
from stepdiag_ros.report.words import (
    SHORT_CHANNELS,
    certainty,
    closed_percent,
    micrometres,
    percent,
    plain,
    quantity,
    title,
)

BADGES = {'no_gap': ('good', 'nothing wrong'), 'hint': ('good', 'nothing for sure'),
          'explained': ('warn', 'cause found'),
          'partly_explained': ('bad', 'partly explained'), 'unexplained': ('bad', 'cause not known')}
SHOWN_PROBABILITY = 0.01
FAR = 100.0
"""Standard deviations beyond which no number is shown."""
LEAST_INSIDE = 0.15
"""Share of the gap inside the stops from which a picture of it is shown."""


def gap_page(diagnosis: Diagnosis, name: str, notes: tuple[str, ...] = (), again: Series | None = None) -> str:
    """The HTML of one diagnosis; ``notes`` are reported among the warnings; ``again``: what the adopted simulator shows
    along the moves of the log."""
    sections = [_head(diagnosis, name), _budget(diagnosis), _causes(diagnosis), _where(diagnosis),
                _pictures(diagnosis), _again(diagnosis, again), _errors(diagnosis), _warnings(diagnosis, notes),
                _small_print(diagnosis)]
    return page(f'{name}: {gap_words.headline(diagnosis)}', '\n'.join(s for s in sections if s))


def _head(diagnosis: Diagnosis, name: str) -> str:
    log, table_ = diagnosis.log, diagnosis.nominal.table
    hinted = diagnosis.hint and not diagnosis.effects
    kind, word = BADGES.get('hint' if hinted else diagnosis.verdict, ('warn', diagnosis.verdict))
    if diagnosis.untold and diagnosis.verdict == 'no_gap':
        kind, word = 'warn', f'nothing wrong, but {WORDS[NOBODY]}'
    when = datetime.fromtimestamp(log.steps.time_ns[0] * 1e-9, UTC)
    minutes = (log.steps.time_ns[-1] - log.steps.time_ns[0]) / 60e9
    runs = f'{len(table_.run_ids)} runs' if len(table_.run_ids) > 1 else 'one run'
    began, lasted = (f'{when:%Y-%m-%d %H:%M} UTC', f'{plain(minutes)} min') if log.description.timed else \
        ('no date', 'times made up')
    kicker = (f'Machine {log.description.machine.name} · log {name} · {began} · {len(table_)} stops in {runs}, '
              f'{lasted}')
    return (f'<header><div class="kicker">{escape(kicker)}</div>'
            f'<h1>{escape(gap_words.headline(diagnosis))}</h1>'
            f'<p><span class="badge {kind}">{word}</span></p>'
            f'<dl class="first"><dt>How sure</dt><dd>{escape(gap_words.how_sure(diagnosis))}</dd>'
            f'<dt>What to do</dt><dd>{escape(gap_words.what_to_do(diagnosis))}</dd></dl>'
            f'<p class="lead">{escape(gap_words.how_far(diagnosis))}</p>'
            + (f'<div class="todo warn2"><b>The lengths are no metres.</b> They are {escape(diagnosis.untold)}</div>'
               if diagnosis.untold else '') + '</header>')


# ---- the budget -----------------------------------------------------------------------------------

def _budget(diagnosis: Diagnosis) -> str:
    rows = gap_words.steps(diagnosis)
    floor = diagnosis.cross_validation.floor_m
    labels = []
    for i, (name, value) in enumerate(rows):
        said = 'machine against simulator, as it is' if i == 0 else \
            '+ unmodelled structure' if name == UNKNOWN else f'+ {title(name)}'
        labels.append((said, value))
    text = ('<h2>How big is the gap?</h2><p>How far a stop lies from where the simulator predicts it, '
            + ('on the log itself: it is one run, nothing could be held out.' if
               diagnosis.cross_validation.held_out.startswith('none') else
               f'on {escape(diagnosis.cross_validation.held_out)} — a part of the log that took no part in the fit.')
            + '</p>')
    return (text + budget_svg(labels, floor) + _budget_narrow(labels, floor)
            + f'<p>{escape(gap_words.further_words(diagnosis.cross_validation))} '
            f'{escape(gap_words.over_setups_words(diagnosis))}</p>')


def _budget_narrow(rows: list[tuple[str, float]], floor: float) -> str:
    """The same bars for a narrow screen, the noise floor as one of them."""
    place = _budget_scale([value for _, value in rows], floor)
    more = [*rows, ('noise floor', floor)]
    scale = ' (bars on a logarithmic scale)' if _logarithmic([value for _, value in rows], floor) else ''
    return ('<div class="narrow">' + bars([(label, place(value), micrometres(value)) for label, value in more])
            + f'<small>Root mean square{scale}.</small></div>')


def _logarithmic(values: list[float], floor: float) -> bool:
    """Whether bars are: where the gap was large the noise floor would vanish."""
    return max([*values, floor]) > 12.0 * floor


def _budget_scale(values: list[float], floor: float) -> Callable[[float], float]:
    """From a gap [m] to the length of its bar, 0 … 1."""
    widest, low = 1.08 * max([*values, floor]), floor / 4.0
    if _logarithmic(values, floor):
        return lambda value: float(max(0.0, np.log(value / low)) / np.log(widest / low))
    return lambda value: value / widest


def budget_svg(rows: list[tuple[str, float]], floor: float) -> str:
    """Bars of the gap, one a row, in µm, with a line at the noise floor; far larger ones are cut open."""
    values = [value for _, value in rows]
    wide, share = _logarithmic(values, floor), _budget_scale(values, floor)

    def place(value: float) -> float:
        return 560.0 * share(value)

    height, out = 34 * len(rows) + 40, []
    for i, (label, value) in enumerate(rows):
        y = 8 + 34 * i
        colour = '#c2572f' if i == 0 and len(rows) > 1 else '#17688a' if i == len(rows) - 1 else '#8a9aa5'
        out.append(f'<text x="410" y="{y + 16}" text-anchor="end" font-size="13.5">{escape(label)}</text>'
                   f'<rect x="420" y="{y}" width="{place(value):.1f}" height="23" rx="2" fill="{colour}"/>'
                   f'<text x="{428 + place(value):.1f}" y="{y + 16}" font-size="13.5" font-weight="600">'
                   f'{micrometres(value)}</text>')
    x, bottom = 420 + place(floor), 34 * len(rows) + 6
    out.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="2" y2="{bottom}" stroke="#22282e" stroke-width="1.4" '
               f'stroke-dasharray="4 3"/><text x="{x:.1f}" y="{bottom + 16}" font-size="12.5" fill="#6b747c" '
               f'text-anchor="middle">noise floor {micrometres(floor)}'
               f'{" (bars on a logarithmic scale)" if wide else ""}</text>')
    return (f'<figure class="broad"><svg viewBox="0 0 1090 {height}" role="img" aria-label="gap budget" '
            f'font-family="system-ui,Helvetica,Arial,sans-serif" fill="#22282e">{"".join(out)}</svg></figure>')


# ---- causes ---------------------------------------------------------------------------------------

def _causes(diagnosis: Diagnosis) -> str:
    if not diagnosis.effects and not diagnosis.unmodelled:
        text = '<h2>What causes it?</h2><p>' + (
            f'No cause is claimed. {escape(gap_words.hint_words(diagnosis))}</p>' if diagnosis.hint else
            'Nothing needs a cause. Every known one was tried, and none predicts the log better than noise does.</p>')
    else:
        text = '<h2>What causes it?</h2>'
        if diagnosis.effects:
            text += table(['what it is', 'how sure', 'size', 'what to do'],
                          [_cause_row(diagnosis, f) for f in diagnosis.effects], 'causes')
            text += f'<p>{escape(gap_words.AMONG_KNOWN)}</p>'
        if diagnosis.hint:
            text += f'<p>{escape(gap_words.hint_words(diagnosis))}</p>'
        if diagnosis.unmodelled:
            what = 'to which this log gives no sure name' if gap_words.stand_ins(diagnosis) else \
                'that is none of the known causes'
            text += (f'<div class="todo warn2"><b>Something is there {what}.</b> '
                     f'What it looks like: {escape(pattern_words(diagnosis.unmodelled))}. '
                     f'{escape(gap_words.correlates_words(diagnosis))} No name was put on '
                     'it, because none predicts it better than a shapeless pattern does.</div>')
    text += _apart(diagnosis)
    text += '<div class="cols"><div><h3>Probability of each cause</h3>' + _ranking(diagnosis) + '</div><div>'
    return text + '<h3>Probability of each combination</h3>' + _sets(diagnosis) + '</div></div>'


def _cause_row(diagnosis: Diagnosis, found: Found) -> list[str]:
    rows = gap_words.sizes(found)
    shown = ''.join(f'<tr><td>{escape(n)}</td><td>{escape(v)}</td></tr>' for n, v in rows[:6])
    numbers = f'<table class="nums">{shown}</table>'
    if len(rows) > 6:
        numbers += f'<small>and {len(rows) - 6} more in gap.json</small><br>'
    moved = gap_words.reach_words(diagnosis, found.name)
    if moved:
        numbers += f'<small>moves {escape(moved)}</small>'
    what = (f'<b>{escape(title(found.name))}</b><br>{escape(found.title)}<br>'
            f'<small>{escape(found.name)}; form: {escape(found.form)}</small>')
    sure = (f'<b>{certainty(found.probability)}</b><br>{percent(found.probability)}<br>'
            f'<small>{escape(gap_words.closes_words(found))}</small>')
    return [what, sure, numbers, escape(found.remedy) or '–']


def _apart(diagnosis: Diagnosis) -> str:
    text = ''
    for group in diagnosis.indistinguishable:
        text += ('<div class="todo warn2"><b>Indistinguishable in this log:</b> '
                 f'{escape(" / ".join(title(n) for n in group))}. Any of them would leave the same '
                 f'traces in these runs. {escape(gap_words.separation_words(diagnosis, group))}</div>')
    if diagnosis.next_measurement:
        join = f' {gap_words.JOIN}' if diagnosis.next_run or diagnosis.hint else ''
        text += f'<div class="todo"><b>Measure next.</b> {escape(diagnosis.next_measurement + join)}</div>'
    return text


def _ranking(diagnosis: Diagnosis) -> str:
    ranked = sorted(diagnosis.ranking.items(), key=lambda item: -item[1])
    rows = [(title(n), p, percent(p)) for n, p in ranked if p >= SHOWN_PROBABILITY][:10]
    return bars(rows) + f'<small>{len(ranked) - len(rows)} others: less each</small>'


def _sets(diagnosis: Diagnosis) -> str:
    # Two patterns without a name read as one.
    together: dict[tuple[str, ...], float] = {}
    for names, p in diagnosis.sets:
        key = tuple(dict.fromkeys(names))
        together[key] = together.get(key, 0.0) + p
    likeliest = sorted(together.items(), key=lambda item: -item[1])[:5]
    return table(['acting together', '>probability'],
                 [[escape(' + '.join(map(title, key)) or 'nothing'), percent(p)] for key, p in likeliest])


# ---- where ----------------------------------------------------------------------------------------

def _where(diagnosis: Diagnosis) -> str:
    text = f'<h2>Where is it?</h2><p>{escape(gap_words.where_words(diagnosis))}</p>'
    shares = diagnosis.margins
    if shares is None:
        return text + _bands(diagnosis)
    kinds = ({(f'after a move of {k}' if len(k) == 1 else k): v for k, v in shares.axis.items()},
             {f'going {k}': v for k, v in shares.direction.items()}, shares.time,
             {gap_words.STATES[k]: v for k, v in shares.state.items()})
    sides = '<div class="sides">' + ''.join(
        bars([(said, v, closed_percent(v)) for said, v in kind.items()]) for kind in kinds if kind) + '</div>'
    measured = [any(band.channel == channel for band in diagnosis.bands) for channel in SHORT_CHANNELS]
    if not shares.cells.any():
        return text + sides + _bands(diagnosis)
    return (text + '<div class="cols"><div>' + _map(shares, diagnosis.log.description, measured) + '</div><div>' + sides
            + '</div></div>' + _bands(diagnosis))


def _map(shares: Margins, description: Description, measured: list[bool]) -> str:
    names, top = shares.setups, shares.cells.max()
    rows = ''
    for c, channel in enumerate(SHORT_CHANNELS.values()):
        if not measured[c]:
            continue
        cells = ''
        for s in range(len(names)):
            said = closed_percent(shares.cells[c, s]) if shares.cells[c, s] >= LEAST_SHARE else '·'
            cells += _shaded(shares.cells[c, s] / top, said)
        rows += f'<tr><th class="r">{escape(channel)}</th>{cells}</tr>'
    heads = ''.join(f'<th>{escape(n)}</th>' for n in names)
    return (f'<div class="scroll"><table class="heat"><tr><th></th>{heads}</tr>{rows}</table></div>'
            f'<small>Share of the gap by what was measured and in which setup: the length by the laser, the spot of '
            'light that tells how the mirror turns. '
            f'{escape(gap_figures.legend_of_setups([description.setups[n] for n in names]))}.</small>')


def _shaded(depth: float, said: str) -> str:
    """A cell of a heat map, the darker the deeper (0 … 1)."""
    return (f'<td style="background:rgba(194,87,47,{0.04 + 0.8 * depth:.2f});'
            f'color:{"#fff" if depth > 0.6 else "#22282e"}">{said}</td>')


def _bands(diagnosis: Diagnosis) -> str:
    """What stands out of the noise by frequency: times the noise, before and after."""
    text = '<h3>By frequency</h3>' + f'<p>{escape(gap_words.bands_words(diagnosis))}</p>'
    if not any(band.stands_out for band in diagnosis.bands):
        return text
    made_up = '' if diagnosis.log.description.timed else ' (made up)'
    for setting, head in gap_words.SETTINGS.items():
        mine = [band for band in diagnosis.bands if band.setting == setting]
        if not mine:
            continue
        periods = list(dict.fromkeys((band.shortest, band.longest) for band in mine))
        rows = ''
        for channel, said in SHORT_CHANNELS.items():
            found = {(band.shortest, band.longest): band for band in mine if band.channel == channel}
            if found:
                rows += f'<tr><th class="r">{escape(said)}</th>' + ''.join(
                    _band_cell(found.get(period)) for period in periods) + '</tr>'
        heads = ''.join(f'<th>{escape(gap_words.period_words(*period, mine[0].unit))}</th>' for period in periods)
        head += made_up if setting == 'time' else ''
        text += f'<div class="scroll"><table class="heat"><tr><th>{head}</th>{heads}</tr>{rows}</table></div>'
    return text + ('<small>Root mean square in times of the noise, before → after what was found is taken out, of what '
                   'the fit leaves; columns are periods. A dot: no more than noise makes.</small>')


def _band_cell(band: Band | None) -> str:
    if band is None or not band.stands_out:
        return '<td>·</td>'
    depth = min(np.log10(max(band.before, 1.0)) / 2.0, 1.0)
    return _shaded(depth, f'{plain(np.sqrt(band.before))} → {plain(np.sqrt(band.after))}')


# ---- pictures -------------------------------------------------------------------------------------

def _pictures(diagnosis: Diagnosis) -> str:
    parts, stops = series(diagnosis), diagnosis.nominal.table
    named = [a for a in diagnosis.joint.active if a.effect.name]
    text = '<h2>What the log shows</h2>'
    if diagnosis.joint.active:
        who = 'what was found' if named else 'unmodelled structure'
        text += '<h3>Machine and simulator over each other</h3>' + figure(
            gap_figures.along_stops(parts, stops, True),
            f'Points: the machine, after its 21 errors and the misalignments have been taken off. Line: the '
            f'simulator with {who}. Length, and the two coordinates of the light spot, at each stop of '
            'each setup, all runs.')
        caption = 'Log minus simulator, without and with what was found.'
    else:
        caption = 'Log minus simulator. Where nothing is wrong the points fill the band of the noise evenly.'
    return (text + '<h3>Residuals at each stop</h3>'
            + figure(gap_figures.along_stops(parts, stops, False), caption, 2)
            + '<h3>Residuals over time</h3>'
            + figure(gap_figures.over_time(parts, stops, diagnosis.log.description.timed),
                     'The same, in the order in which it was measured.') + _inside(diagnosis) + _swings(diagnosis))


def _again(diagnosis: Diagnosis, parts: Series | None) -> str:
    """The adopted simulator against the log; '' where none was."""
    if parts is None:
        return ''
    stops = diagnosis.nominal.table
    return ('<h2>The adopted simulator</h2><p>The simulator that was written was run along the moves of this log, '
            'with the errors, misalignments and effects of its file.</p>'
            + figure(gap_figures.along_stops(parts, stops, True),
                     'Points: the machine, less the simulator without its effects. Line: what the simulator\'s '
                     'effects do.')
            + figure(gap_figures.along_stops(parts, stops, False),
                     'Log minus simulator: before, without effects, as it was fitted; after, as it was adopted.'))


def _inside(diagnosis: Diagnosis) -> str:
    """What happens while the machine stands still, where a good part of the gap is there."""
    shares = diagnosis.margins
    if shares is None or shares.state[SETTLING] < LEAST_INSIDE or not diagnosis.joint.active:
        return ''
    return '<h3>While the machine stands still</h3>' + figure(
        gap_figures.inside_stops(inside(diagnosis), diagnosis.nominal.table),
        'How the reading moves from the beginning of a stop to its end. Points: the machine; line: the '
        'simulator with what was found.')


def _swings(diagnosis: Diagnosis) -> str:
    """The spectrum of what swings while the machine stands still."""
    found = spectra(diagnosis)
    return '' if not found else '<h3>What swings while the machine stands still</h3>' + figure(
        gap_figures.spectra(found),
        'What keeps its phase through a run, all runs together. The marked line is the swing; those beside it, at the '
        'pace of the stops, are its shadows.')


def _errors(diagnosis: Diagnosis) -> str:
    text = '<h2>What it means for the 21 errors</h2>'
    known = ('with bands of k = 2 of repeats and of an index of air that nobody tells' if diagnosis.untold else
             'at the temperature of the measurement, with bands of k = 2 of what repeats; at 20 °C and with the whole '
             'budget they stand in <code>stepdiag evaluate</code>')
    if not diagnosis.joint.active:
        return text + (f'<p>There is nothing to take out: these are the errors of the machine, {known}.</p>') + figure(
            gap_figures.errors_before_after(diagnosis.shown(diagnosis.plain), None),
            'The 18 error curves and the three squareness errors.')
    freed = diagnosis.solution
    moved = [row for row in gap_words.changes(diagnosis.plain, freed) if row[2] > 2.0]
    if moved:
        taken = 'the causes' if diagnosis.effects else 'the pattern'
        text += ('<p>A plain evaluation would have put part of the trouble into the machine\'s errors. With '
                 f'{taken} taken out these change most:</p>')
        text += table(['error', '>changes by', '>in standard deviations'],
                      [[n, quantity(c, 'm' if len(n) == 3 and n[1] in 'XYZ' else 'rad', abs(c) / s),
                        plain(s) if s < FAR else f'more than {FAR:.0f}']
                       for n, c, s in moved[:6]])
    else:
        text += ('<p>No error changes by more than twice its standard deviation when the causes are taken '
                 'out: a plain evaluation of this log was not misled.</p>')
    text += f'<p>{escape(gap_words.volume_words(diagnosis.volume_change))}</p>'
    return text + f'<p>The errors are shown {known}.</p>' + figure(
        gap_figures.errors_before_after(diagnosis.shown(diagnosis.plain), diagnosis.shown(freed)),
        'The 18 error curves and the three squareness errors, bands k = 2.')


# ---- the end --------------------------------------------------------------------------------------

def _warnings(diagnosis: Diagnosis, notes: tuple[str, ...]) -> str:
    lines = (*diagnosis.warnings, *notes)
    if not lines:
        return ''
    return '<h2>Notes</h2><ul>' + ''.join(f'<li>{escape(line)}</li>' for line in lines) + '</ul>'


def _small_print(diagnosis: Diagnosis) -> str:
    noise, gap = diagnosis.joint.noise, diagnosis.cross_validation
    source = ('taken from the repeats of this log' if noise.source == 'repeats'
              else 'as the maker of the log states it, for the log has no repeats')
    return ('<footer><p><b>How this was judged.</b> The simulator is a rigid machine with 21 errors, misaligned '
            'laser and mirror, and a reset in each run. All of these are fitted to the log first; what such '
            'a fit could imitate is taken out of the view, and only in the rest are causes looked for. '
            'Each known cause, alone and together, in each of its forms, is weighed by how well it '
            'predicts the log against how much it could have fitted; unmodelled structure takes part under '
            'the same price, so that a name is given only where it predicts better. Then machine and causes '
            'are fitted together.</p>'
            f'<p>Noise, {source}: each arrival of an axis errs by {quantity(noise.position, "m")}, the '
            f'mirror\'s angle by {quantity(noise.angle, "rad")} (one standard deviation). The gap is the '
            f'root mean square of the {gap.channel} read less the {gap.channel} predicted by a fit without these '
            f'readings ({escape(gap.held_out)}). In units of what the prediction expects of itself, the reduced χ² is '
            f'{plain(gap.before)} before, {plain(gap.after)} after, over {gap.count} readings. '
            'Values ± one standard uncertainty (k = 1); all of it is in <code>gap.json</code> beside this page.</p>'
            '</footer>')
