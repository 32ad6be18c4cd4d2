"""The page and the summary of a diagnosis: well-formed, self-contained, and saying what is wrong."""

import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from stepdiag_ros.estimate.prediction import deviation
from stepdiag_ros.gap.diagnosis import Found
from stepdiag_ros.gap.summary.cross_validation import CrossValidation, Distance
from stepdiag_ros.model.machine import CURVES
from stepdiag_ros.report import gap_figures
from stepdiag_ros.report.gap_page import budget_svg, gap_page
from stepdiag_ros.report.gap_words import (
    bands_words,
    changes,
    closed_share,
    headline,
    period_words,
    steps,
    summary,
    where_words,
)
from stepdiag_ros.report.series import series, spectra

VOID = {'meta', 'br', 'img', 'hr', 'link', 'input'}
BACKLASH = {'B': [4e-6, 3e-6, 5e-6]}


class Page(HTMLParser):
    """Tags balanced, text collected, addresses of anything fetched."""

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.words: list[str] = []
        self.fetched: list[str] = []
        self.ids: list[str] = []
        self.counts: dict[str, int] = {}
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.counts[tag] = self.counts.get(tag, 0) + 1
        for key, value in attributes:
            if key in ('src', 'href', 'xlink:href') and value and not value.startswith(('#', 'data:')):
                self.fetched.append(value)
            if key == 'id':
                self.ids.append(value)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f'</{tag}> closes {self.open[-1:]}'
        self.open.pop()

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ('style', 'defs'):
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r'\s+', ' ', ' '.join(self.words))


@pytest.fixture(scope='module')
def backlash(diagnosed):
    return diagnosed('backlash', BACKLASH, ('backlash', 'psd_gain', 'servo_settling'))


@pytest.fixture(scope='module')
def backlash_page(backlash):
    return Page(gap_page(backlash, 'some_log', ('a <note>',)))


def test_page_is_whole_and_fetches_nothing(backlash_page):
    assert backlash_page.fetched == []
    assert len(backlash_page.ids) == len(set(backlash_page.ids))
    assert backlash_page.counts['svg'] >= 5
    assert backlash_page.counts['h1'] == 1


def test_page_says_what_is_wrong(backlash_page):
    text = backlash_page.text
    for said in ('depending on the direction it came from', 'Backlash (lost motion on reversal)',
                 'practically certain', 'ball screw', 'noise floor', 'laser', 'EXX', 'a <note>', 'How this was judged',
                 'each repeat in turn', 'Of a further repeat', 'one in four'):
        assert said in text, said
    assert re.search(r'X 3\.\d|X 4\.\d', text)
    assert 'µm' in text and ' m)' not in text


def test_summary_says_what_is_wrong(backlash):
    text = summary(backlash, 'some_log', ('cell written to x.yaml',))
    first = text.splitlines()[0]
    assert first.startswith('some_log: An axis stops at a different place')
    assert re.search(r'Y +3\.\d+ ± 0\.\d+ µm', text)
    for said in ('noise alone', '[backlash]: practically certain', 'What to do: Check the ball screw',
                 'Where: ', 'note: cell written to x.yaml'):
        assert said in text, said


def test_a_shake_is_shown_in_its_spectrum(diagnosed):
    shaken = diagnosed('vibration', {'amp': [0.0, 0.0, 1e-7], 'frequency': 11.7}, dwell=0.5)
    text = Page(gap_page(shaken, 'shaken')).text
    assert 'What swings while the machine stands still' in text
    assert 'Sampled at 40 Hz, 28.3 Hz and 51.7 Hz look the same' in text
    (channel, seen), = spectra(shaken).items()
    assert channel == 0
    assert seen.hertz[seen.strongest] == pytest.approx(11.7, abs=0.05)
    assert spectra(diagnosed('')) == {}


def test_null_log_is_called_sound(diagnosed):
    diagnosis = diagnosed('')
    page = Page(gap_page(diagnosis, 'quiet'))
    assert headline(diagnosis).startswith('Nothing is wrong that this log could show')
    assert 'nothing wrong' in page.text and 'Nothing needs a cause' in page.text
    assert where_words(diagnosis).startswith('Nowhere')
    assert 'stands out of the noise by itself' in page.text
    assert 'what to do' not in page.text and 'one in four' not in page.text


def test_a_name_that_may_be_part_of_something_else_is_said_so(backlash):
    """Which of the two it is the log does not tell; the other cause is none that the name could be exchanged for."""
    one = replace(backlash, verdict='partly_explained', unmodelled='spot: off',
                  sets=((('unknown',), 0.52), (('backlash', 'unknown'), 0.48)))
    one = replace(one, effects=tuple(replace(f, probability=0.48) for f in one.effects))
    said = headline(one)
    assert said.startswith('Something acts that is none of the known causes') and 'does all of it' in said
    assert '(48 %)' in said and 'Either' not in said
    sure = replace(one, sets=((('backlash', 'unknown'), 1.0),))
    assert 'something more that is none' in headline(sure) and 'does all of it' not in headline(sure)


def test_wrong_stamps_are_seen_while_axes_move(diagnosed):
    late = Found('clock_skew', 'Stamps are late.', 0.99, {'psd_s': 0.05}, {'psd_s': 1e-4}, 's', '', 1.0, '')
    diagnosis = replace(diagnosed(''), verdict='explained', effects=(late,))
    assert where_words(diagnosis).startswith('In what is read while the axes move')
    page = Page(gap_page(diagnosis, 'late'))
    assert 'after a move of' not in page.text


def test_frequencies_are_shown_where_they_stand_out(backlash, backlash_page):
    assert 'opposite on the way back' in bands_words(backlash)
    assert 'Root mean square in times of the noise' in backlash_page.text
    assert '1.20 … 120 s' in period_words(1.2, 120.0, 's')


def test_the_change_of_the_volumetric_error_is_said(backlash, backlash_page):
    change = backlash.volume_change
    assert 0.0 < change.rms <= change.largest and change.sigma > 0.0
    assert 'In the working volume the predicted place of the tool changes by up to' in backlash_page.text
    assert backlash.to_json_dict()['volumetric_change']['largest_m'] == change.largest
    machine = backlash.log.description.machine
    plain = backlash.plain
    point = np.array([change.at])
    moved = deviation(backlash.solution.errors, machine, point) - deviation(plain.errors, machine, point)
    assert np.linalg.norm(moved) == pytest.approx(change.largest)


def test_unexplained_is_not_named(diagnosed):
    """Backlash in the log, and nothing looked for that could explain it."""
    diagnosis = diagnosed('backlash', BACKLASH, ('psd_rotation',))
    assert diagnosis.verdict in ('unexplained', 'partly_explained')
    text = Page(gap_page(diagnosis, 'odd')).text
    assert 'none of the known causes' in text
    assert 'Backlash' not in text
    assert 'Not explained: ' in summary(diagnosis, 'odd')


def test_what_cannot_be_told_apart_and_next_measurement_are_shown(backlash):
    doubtful = replace(backlash, indistinguishable=(('backlash', 'count_slip'),),
                       next_measurement='Run ppp once more, backwards first.')
    text = Page(gap_page(doubtful, 'x')).text
    assert 'Indistinguishable in this log' in text and 'Laser lost count' in text
    assert 'Run ppp once more, backwards first.' in text
    said = summary(doubtful, 'x')
    assert 'Indistinguishable in this log' in said and 'Measure next: Run ppp' in said
    weighed = replace(doubtful, separation={'count_slip': np.log(4.0)})
    assert 'The evidence is 4 to one against “Laser lost count”; it takes 20 to one' in summary(weighed, 'x')
    assert '4 to one against' in Page(gap_page(weighed, 'x')).text
    assert weighed.to_json_dict()['separation'] == {'count_slip': np.log(4.0)}


def test_budget_goes_from_before_to_after(backlash):
    rows = steps(backlash)
    assert [name for name, _ in rows] == ['before', 'backlash']
    assert rows[0][1] == backlash.cross_validation.before_m and rows[-1][1] == backlash.cross_validation.after_m
    assert rows[-1][1] < rows[0][1]
    assert closed_share(backlash) > 0.9


def test_budget_bars_are_in_proportion():
    drawn = budget_svg([('before', 4e-6), ('after', 1e-6)], 1e-6)
    widths = [float(w) for w in re.findall(r'<rect [^>]*?width="([\d.]+)"', drawn)]
    assert widths[0] == pytest.approx(4 * widths[1], rel=1e-2)
    line = float(re.search(r'<line x1="([\d.]+)"', drawn)[1])
    assert line == pytest.approx(420 + widths[1], abs=0.2)
    large = budget_svg([('before', 4e-4), ('after', 1e-6)], 1e-6)
    assert 'logarithmic' in large


def test_changes_of_the_errors_are_ranked(backlash):
    rows = changes(backlash.plain, backlash.solution)
    assert len(rows) == 21
    assert [r[2] for r in rows] == sorted((r[2] for r in rows), reverse=True)


def test_pictures_hold_every_reading_with_its_unit(backlash):
    """Points of all stops, before and after, channels with units, each error with its own."""
    parts, table = series(backlash), backlash.nominal.table
    known = int(np.isfinite(parts.before).sum())
    drawn = gap_figures.along_stops(parts, table, False)
    assert len(re.findall(r'M[\d.-]+ [\d.-]+h0', drawn)) == known + drawn.count('M11 6h0')
    triangles = [len(re.findall(rf'M[\d.-]+ [\d.-]+l{sign}3\.6-1\.9v3\.8z', drawn)) for sign in ('-', '')]
    ways = (table.direction > 0, table.direction < 0)
    assert triangles == [int(np.isfinite(parts.before[way]).sum()) for way in ways]
    for channel in ('length', 'spot x', 'spot y'):
        assert re.search(rf'>{channel} \[(nm|µm|mm)\]<', drawn), channel
    for name in table.setup_names:
        assert f'>{name}<' in drawn
    errors = gap_figures.errors_before_after(backlash.plain, backlash.solution)
    for name in CURVES:
        assert f'>{name} [{"µm" if name[1] in "XYZ" else "µrad"}]<' in errors
    assert re.search(r'EC0Y squareness: −?[\d.]+ ± [\d.]+ µrad \(k = 2\)', errors)


def test_names_of_setups_cannot_break_the_page(backlash):
    parts, table = series(backlash), backlash.nominal.table
    evil = replace(table, setup_names=('<img src=x onerror=alert(1)>', *table.setup_names[1:]))
    for drawn in (gap_figures.along_stops(parts, evil, False), gap_figures.over_time(parts, evil)):
        assert '<img' not in drawn and '&lt;img src=x' in drawn


def test_the_first_screen_says_how_sure_and_what_to_do(backlash, diagnosed):
    text = Page(gap_page(backlash, 'x')).text
    first = text[:text.index('How big is the gap?')]
    assert 'How sure Backlash (lost motion on reversal): practically certain (> 99.9 %)' in first
    assert 'What to do Check the ball screw' in first
    text = Page(gap_page(diagnosed(''), 'x')).text
    first = text[:text.index('How big is the gap?')]
    assert re.search(r'How sure \d+ % that nothing acts', first) and 'What to do' not in text[len(first):]
    assert 'Nothing that this log asks for.' in first


def test_the_page_needs_no_drawing_library():
    """Neither Matplotlib nor scipy.stats, each slower to import than the page is to write."""
    code = ('import sys, stepdiag_ros.cli.gap, stepdiag_ros.bag.reader, stepdiag_ros.gap.diagnose, '
            'stepdiag_ros.report.gap_page; '
            'print([name for name in ("matplotlib", "scipy.stats") if name in sys.modules])')
    assert subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          check=True).stdout.strip() == '[]'


def test_patterns_without_a_name_are_one_row(backlash):
    doubled = replace(backlash, sets=((('unknown',), 0.6), (('unknown', 'unknown'), 0.3), ((), 0.1)))
    text = Page(gap_page(doubled, 'x')).text
    assert 'Something that is not in the list 90 % nothing 10 %' in text


@pytest.mark.parametrize(('after', 'beyond'), [(1.05, False), (1.3, False), (1.6, True)])
def test_what_chance_may_leave_is_not_something_more(after, beyond):
    validation = CrossValidation(1.07, after, 1272, 528.0, 'each repeat', {'displacement': Distance(
        3.45e-7, 3.30e-7, 2.57e-7, 2.0e-7)})
    assert validation.left == pytest.approx(0.82, abs=0.03)
    assert validation.beyond_chance == beyond
