"""The picture and the page of an evaluation."""

import re

import pytest

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate import evaluate
from stepdiag_ros.report.evaluation_page import evaluation_page
from stepdiag_ros.report.figures import calibration_figure
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.offline import simulate_log

from ..conftest import small_cell


@pytest.fixture(scope='module')
def evaluated():
    cell = small_cell({})
    return cell, evaluate(simulate_log(cell))


def test_picture_is_drawn_with_the_truth_and_without(evaluated, tmp_path):
    cell, solution = evaluated
    assert isinstance(cell, Cell)
    calibration_figure(solution, cell.geometry, tmp_path / 'with.svg')
    calibration_figure(solution, None, tmp_path / 'without.svg')
    with_truth, without = ((tmp_path / f'{n}.svg').read_text(encoding='utf-8') for n in ('with', 'without'))
    dashed = [len(re.findall('stroke-dasharray', text)) for text in (with_truth, without)]
    # 18 curves, three squareness errors and the legend.
    assert dashed == [22, 0]
    calibration_figure(solution, cell.geometry, tmp_path / 'picture.png')
    assert (tmp_path / 'picture.png').read_bytes().startswith(b'\x89PNG')


def test_picture_that_cannot_be_written(evaluated, tmp_path):
    with pytest.raises(StepdiagError, match='cannot be written'):
        calibration_figure(evaluated[1], None, tmp_path / 'no' / 'folder.png')


def test_page_of_an_evaluation(evaluated):
    cell, solution = evaluated
    text = evaluation_page(solution, cell.description, 'some_log')
    # The curves, how far each run closed and the residuals.
    assert text.count('<svg') == 3 and 'http://' not in re.sub(r'xmlns[^ >]*|"http://www.w3.org[^"]*"', '', text)
    for said in ('The machine misses by up to', 'Squareness', 'EA0Z', 'lin_x laser u', 'cosine error',
                 'How laser and mirror were aligned', 'Reduced χ²'):
        assert said in text, said
