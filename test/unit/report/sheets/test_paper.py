"""The pages of a sheet: nothing is printed over anything else or beyond the margins."""

from itertools import pairwise

import pytest

from stepdiag_ros.report.sheets.paper import A4, RIGHT, _Paper
from stepdiag_ros.report.sheets.sheet import Grid

LONG = 'body diagonal from (0, 0, 0) to (200, 160, 120) mm, axes together'
NARROW_ONES = Grid('Targets', ('>target [mm]', '>mean [µm]', '>U (k = 2)'), (('0.000', '-1.234', '0.321'),) * 4)
WIDE_ONES = Grid('Stations [mm]', ('', 'stated X / Y / Z', '>X', '>Y', '>Z', '>dead path', '>targets',
                                   '>residual rms [µm]'), (
    ('station_1', '-150.0 / -120.0 / -100.0', '-150.4626 ± 0.023', '-121.5695 ± 0.028', '-99.2069 ± 0.038',
     '194.5522 ± 0.0014', '27', '0.311'),) * 3)
WORDS = Grid('Diagonals', ('', 'diagonal', '>E [µm]', 'what is said of it'), (('body_ppp', LONG, '9.719', LONG),) * 3)
TOO_WIDE = Grid('Many', tuple(f'>column_{k}' for k in range(24)), (('-1234.567',) * 24,))


def lines_of(grid):
    """Texts of a page by the height that they stand at, as (left, right) [inch]."""
    paper = _Paper('heading')
    paper.grid(grid)
    paper.page.canvas.draw()
    rows = {}
    for text in paper.page.texts[2:]:     # heading and number of the page
        box = text.get_window_extent()
        rows.setdefault(round(box.y1), []).append((box.x0 / paper.page.dpi, box.x1 / paper.page.dpi, text.get_text()))
    return rows


@pytest.mark.parametrize('grid', [NARROW_ONES, WIDE_ONES, WORDS, TOO_WIDE], ids=lambda grid: grid.title)
def test_no_cell_is_printed_over_another(grid):
    rows = lines_of(grid)
    assert rows
    for row in rows.values():
        for (_, end, text), (begin, _, other) in pairwise(sorted(row)):
            assert end < begin + 0.02, (text, other)
        assert max(end for _, end, _ in row) < RIGHT + 0.05 < A4[0]


def test_a_long_title_is_put_into_lines():
    from stepdiag_ros.report.sheets.paper import TITLE, _width, _wrapped
    lines = _wrapped('Rectangular paths, the beam follows, Ibaraki & Hiruya 2020, section 2.2', 6.8, TITLE, 'bold')
    assert len(lines) == 2 and all(_width(line, TITLE, 'bold') < 6.8 for line in lines)
