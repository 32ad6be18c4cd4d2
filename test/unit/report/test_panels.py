"""Small multiples: scales, ticks, points, what is cut off, text that comes from logs."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from stepdiag_ros.report.panels import LEFT, RIGHT, Panel, legend, picture, side_by_side, span, ticks


@pytest.mark.parametrize(('low', 'high', 'most', 'said'), [
    (-0.7, 0.8, 4, ['−0.5', '0', '0.5']),
    (0.0, 24.0, 6, ['0', '5', '10', '15', '20']),
    (0.0, 800.0, 5, ['0', '200', '400', '600', '800']),
    (-2.3e-3, 4e-3, 4, ['−0.002', '0', '0.002', '0.004'])])
def test_ticks_are_round(low, high, most, said):
    places, texts = ticks(low, high, most)
    assert texts == said
    assert [float(text.replace('−', '-')) for text in texts] == pytest.approx(list(places))


def test_ticks_are_never_more_than_asked_for():
    random = np.random.default_rng(1)
    for low, wide, most in zip(random.normal(0, 5, 200), 10.0 ** random.uniform(-9, 6, 200),
                               random.integers(2, 12, 200), strict=True):
        places, _ = ticks(low, low + wide, int(most))
        assert 1 <= len(places) <= most
        assert low - 1e-6 * wide <= places[0] and places[-1] <= low + 1.000001 * wide
        assert len(places) < 3 or np.ptp(np.diff(places)) < 1e-6 * wide


def test_a_range_holds_all_that_is_known():
    low, high = span(np.array([1.0, np.nan, 3.0]), np.array([2.0, np.inf]))
    assert low < 1.0 and high > 3.0 and high - low < 2.5
    assert span(np.array([np.nan])) == pytest.approx((-1.12, 1.12))
    low, high = span(np.array([5.0]))
    assert low < 5.0 < high


def test_points_lie_where_their_values_are():
    panel = Panel(10.0, 20.0, 100.0, 50.0, (0.0, 10.0), (-1.0, 1.0))
    panel.points(np.array([0.0, 5.0, 10.0, 3.0]), np.array([-1.0, 0.0, 1.0, np.nan]), 'after')
    places = re.findall(r'M([\d.]+) ([\d.]+)h0', panel.svg())
    assert [(float(x), float(y)) for x, y in places] == [(0.0, 50.0), (50.0, 25.0), (100.0, 0.0)]
    for shape, tip in ((RIGHT, 51.8), (LEFT, 48.2)):
        one = Panel(0.0, 0.0, 100.0, 50.0, (0.0, 10.0), (-1.0, 1.0))
        one.points(np.array([5.0]), np.array([0.0]), 'after', shape=shape)
        assert f'M{tip} 25.0' in one.svg()


def test_a_line_is_broken_between_parts_and_a_band_is_closed():
    panel = Panel(0.0, 0.0, 100.0, 100.0, (0.0, 4.0), (0.0, 1.0))
    panel.line(np.arange(5.0), np.zeros(5), 'after', part=np.array([1, 1, 2, 2, 2]))
    panel.band(np.array([0.0, 4.0]), np.array([0.25, 0.25]), np.array([0.75, 0.75]), 'noise')
    line, band = re.findall(r'd="([^"]*)"', ''.join(panel.drawn))
    assert line.count('M') == 2 and line.count('L') == 3
    assert band == 'M0.0 75.0L100.0 75.0L100.0 25.0L0.0 25.0z'


def test_text_is_escaped_and_the_drawing_is_xml():
    panel = Panel(40.0, 20.0, 100.0, 50.0, (0.0, 1.0), (0.0, 1.0))
    panel.frame('<script>alert(1)</script>', 'stop & go', 'length [µm]')
    drawn = picture([panel], 200.0, 100.0, 'a "label" <b>')
    root = ET.fromstring(drawn)
    assert root.get('aria-label') == 'a "label" <b>' and root.get('role') == 'img'
    texts = [node.text for node in root.iter('text')]
    assert {'<script>alert(1)</script>', 'stop & go', 'length [µm]'} <= set(texts)
    assert '<script' not in drawn
    assert '&lt;i&gt;' in legend([('dot', 'after', '<i>')])
    assert side_by_side([drawn], 165.0).count('<svg class="panels"') == 1


def test_what_leaves_a_panel_is_cut_off():
    """The data are drawn in an ``svg`` of the panel's own size, which browsers clip."""
    panel = Panel(40.0, 20.0, 100.0, 50.0, (0.0, 1.0), (0.0, 1.0))
    panel.line(np.array([0.0, 1.0]), np.array([0.5, 9.0]), 'after')
    inner = next(iter(ET.fromstring(picture([panel], 200.0, 100.0, 'x'))))
    assert {key: inner.get(key) for key in ('x', 'y', 'width', 'height')} == {
        'x': '40.0', 'y': '20.0', 'width': '100.0', 'height': '50.0'}
    assert inner.find('path') is not None
