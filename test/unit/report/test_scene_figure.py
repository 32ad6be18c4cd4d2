"""The picture of a setup: what is drawn is what was traced."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from stepdiag_ros.cli.main import main
from stepdiag_ros.cli.scene import traced
from stepdiag_ros.report.space import Camera
from stepdiag_ros.virtual.cell import load_cell

DEMO = Path(__file__).parents[3] / 'cells' / 'demo.yaml'


@pytest.mark.parametrize('setup', ['npp', 'lin_z', 'all'])
def test_a_picture_of_any_setup(tmp_path, setup, capsys):
    out = tmp_path / 'scene.png'
    assert main(['scene', str(DEMO), '--setup', setup, '--out', str(out)]) == 0
    assert str(out) in capsys.readouterr().out
    picture = imread(out)
    assert picture.shape[0] > 600
    assert 0.02 < np.mean(picture[..., :3].min(axis=2) < 0.95) < 0.5


def test_svg_holds_lines_and_is_reproducible(tmp_path):
    pictures = []
    for name in ('a.svg', 'b.svg'):
        assert main(['scene', str(DEMO), '--out', str(tmp_path / name)]) == 0
        text = (tmp_path / name).read_text(encoding='utf-8')
        assert '<image' not in text
        pictures.append([line for line in text.splitlines() if '<dc:date>' not in line])
    assert pictures[0] == pictures[1]


def test_the_mirror_covers_every_strike():
    scene = traced(load_cell(DEMO), 'pnp')
    centre, half = scene.mirror_half
    for line in (*scene.beams, scene.psd):
        assert np.all(np.abs(scene.on_mirror(line[1]) - centre) < half)
    # With three steps an axis moved at a time the mirror is left by about one step's sideways part.
    assert 0.02 < half[0] < 0.1


def test_the_projection_keeps_lengths_square_to_the_eye():
    camera = Camera(np.array([0.8, 0.6, 0.5]))
    for row in camera.screen:
        assert np.linalg.norm(camera(row)) == pytest.approx(1e3)
    assert np.linalg.norm(camera(camera.eye)) < 1e-9
    assert camera(np.array([0.0, 0.0, 1.0]))[1] > 0.0


@pytest.mark.parametrize(('more', 'complaint'), [
    (['--setup', 'xyz', '--out', 'a.png'], "no setup 'xyz'"),
    (['--out', 'a.doc'], 'unknown kind of picture'),
    (['--out', '/nonexistent/folder/a.png'], 'cannot be written'),
])
def test_bad_requests_are_one_line(more, complaint, capsys):
    assert main(['scene', str(DEMO), *more]) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert len(error.strip().splitlines()) == 1
