"""The volumetric component's own mathematics, compiled alone, against the rigid-body model."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import stepdiag_ros.linuxcnc
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.linuxcnc import volume
from stepdiag_ros.linuxcnc.matrix import matrix, matrixkins_hal
from stepdiag_ros.model.machine import Curve, GeometricErrors, tool_pose

from .drawn_machine import ORIGIN, TOOL, TRAVEL, drawn_errors

SOURCES = Path(stepdiag_ros.linuxcnc.__file__).parent
WRAPPER = """
#include <stdlib.h>
#include "volume_field.h"
field_t *make(void) { return calloc(1, sizeof(field_t)); }
void drop(field_t *f) { free(f); }
const char *read_file(field_t *f, const char *path) { return field_read(f, path); }
double largest(field_t *f) { return f->largest; }
void forward(field_t *f, double *q, double *tool, double s, double *x) { field_forward(f, q, tool, s, x); }
int inverse(field_t *f, double *x, double *tool, double s, double *q) { return field_inverse(f, x, tool, s, q); }
"""
needs_gcc = pytest.mark.skipif(shutil.which('gcc') is None, reason='no gcc: the C of the component is not compiled')


class Component:
    """The C code, loaded."""

    def __init__(self, folder: Path, text: str):
        (folder / 'wrapper.c').write_text(WRAPPER)
        subprocess.run(['gcc', '-O2', '-Wall', '-Wextra', '-Werror', '-shared', '-fPIC', f'-I{SOURCES}',
                        'wrapper.c', '-o', 'field.so', '-lm'], cwd=folder, check=True)
        (folder / 'volume.txt').write_text(text)
        self._c = ctypes.CDLL(str(folder / 'field.so'))
        self._c.make.restype = ctypes.c_void_p
        self._c.read_file.restype = ctypes.c_char_p
        self._c.largest.restype = ctypes.c_double
        self.field = ctypes.c_void_p(self._c.make())
        self.wrong = self._c.read_file(self.field, str(folder / 'volume.txt').encode())

    def _call(self, function, place_m, tool_m, scale) -> np.ndarray:
        vector = ctypes.c_double * 3
        out = vector()
        self.turns = function(self.field, vector(*(1e3 * np.asarray(place_m))), vector(*(1e3 * np.asarray(tool_m))),
                              ctypes.c_double(scale), out)
        return np.array(out) * 1e-3

    def forward(self, q, tool=TOOL, scale=1.0):
        return self._call(self._c.forward, q, tool, scale)

    def inverse(self, x, tool=TOOL, scale=1.0):
        return self._call(self._c.inverse, x, tool, scale)

    @property
    def largest(self) -> float:
        return self._c.largest(self.field) * 1e-3


@needs_gcc
@pytest.mark.parametrize('chain', ['FXYZ', 'XFYZ', 'XYFZ', 'YXFZ', 'ZFXY'])
def test_forward_is_the_rigid_body_model(tmp_path, chain):
    errors = drawn_errors()
    component = Component(tmp_path, volume.volume_file(errors, 'a', TOOL, TRAVEL, ORIGIN, chain))
    assert component.wrong is None
    rng = np.random.default_rng(1)
    for q in rng.uniform(0.0, TRAVEL, (50, 3)):
        point, _ = tool_pose(errors, q, np.array(TOOL), chain)
        seen = component.forward(q + ORIGIN) - ORIGIN
        np.testing.assert_allclose(seen, point[0] - TOOL, atol=2e-15)


@needs_gcc
def test_forward_of_inverse_is_the_same_place(tmp_path):
    component = Component(tmp_path, volume.volume_file(drawn_errors(size=5e-5, angle=2e-4), 'a', TOOL, TRAVEL, ORIGIN))
    assert component.wrong is None
    rng = np.random.default_rng(2)
    span = np.array(TRAVEL)
    for x in rng.uniform(-0.2 * span, 1.2 * span, (500, 3)) + ORIGIN:
        for scale in (0.0, 0.3, 1.0):
            q = component.inverse(x, scale=scale)
            assert component.turns <= 10
            np.testing.assert_allclose(component.forward(q, scale=scale), x, atol=1e-15)


@needs_gcc
def test_another_tool_has_another_lever(tmp_path):
    errors = drawn_errors()
    component = Component(tmp_path, volume.volume_file(errors, 'a', TOOL, TRAVEL))
    q, longer = np.array([0.1, 0.07, 0.03]), np.array([0.0, 0.0, -0.3])
    point, _ = tool_pose(errors, q, longer)
    np.testing.assert_allclose(component.forward(q, longer), point[0] - longer, atol=2e-15)


@needs_gcc
def test_python_and_c_agree_outside_the_volume_and_backwards(tmp_path):
    errors = drawn_errors()
    component = Component(tmp_path, volume.volume_file(errors, 'a', TOOL, TRAVEL))
    places = np.random.default_rng(3).uniform(-0.05, 0.25, (60, 3))
    expected = volume.inverse(errors, places, TOOL, TRAVEL)
    for x, q in zip(places, expected, strict=True):
        np.testing.assert_allclose(component.inverse(x), q, atol=2e-15)
    assert component.largest == pytest.approx(volume.largest_error(errors, TOOL, TRAVEL), rel=1e-9)


@needs_gcc
@pytest.mark.parametrize('change, wrong', [
    (lambda t: ''.join(t.splitlines(True)[:12]), 'end'), (lambda t: t[:len(t) // 2], 'does not end'),
    (lambda t: t.rsplit('end', 1)[0], 'end'),
    (lambda t: t.replace('limit 0.', 'limit 9.'), 'check sum'), (lambda t: '', 'first line'),
    (lambda t: t.replace('stepdiag-volume 1', 'stepdiag-volume 2'), 'first line')])
def test_a_damaged_file_compensates_nothing(tmp_path, change, wrong):
    text = volume.volume_file(drawn_errors(), 'a', TOOL, TRAVEL)
    component = Component(tmp_path, change(text))
    assert wrong in component.wrong.decode()
    q = np.array([0.1, 0.1, 0.1])
    np.testing.assert_array_equal(component.forward(q), q)
    np.testing.assert_array_equal(component.inverse(q), q)


@needs_gcc
def test_the_component_refuses_what_is_too_large_or_too_steep(tmp_path):
    text = volume.volume_file(drawn_errors(), 'a', TOOL, TRAVEL)

    def signed(body: str) -> str:
        body = body.rsplit('end', 1)[0]
        return body + f'end {volume.check_sum(body):08x}\n'

    small = signed('\n'.join('limit 0.0001' if line.startswith('limit') else line for line in text.splitlines()))
    (tmp_path / 'a').mkdir()
    assert b'beyond its limit' in Component(tmp_path / 'a', small).wrong
    steep = GeometricErrors({'EXX': Curve(np.array([0.0, 0.1, 0.11, 0.2]), np.array([0.0, 0.0, 2e-4, 0.0]))}, {})
    (tmp_path / 'b').mkdir()
    assert b'steep' in Component(tmp_path / 'b', volume.volume_file(steep, 'a', TOOL, TRAVEL)).wrong


def test_more_than_a_millimetre_is_not_written():
    huge = GeometricErrors({'EXX': Curve(np.array([0.0, 0.2]), np.array([0.0, 2e-3]))}, {})
    with pytest.raises(StepdiagError, match='at most'):
        volume.volume_file(huge, 'a', TOOL, TRAVEL)


def test_the_matrix_undoes_squareness_and_scale():
    errors = GeometricErrors({'EXX': Curve(np.array([0.0, 0.2]), np.array([0.0, 4e-6]))},
                             {'EC0Y': 3e-5, 'EB0Z': -2e-5, 'EA0Z': 1e-5})
    c = matrix(errors, scale=(2e-5, 0.0, 0.0))
    for axes in np.random.default_rng(4).uniform(0.0, TRAVEL, (20, 3)):
        point, _ = tool_pose(errors, c @ axes, np.zeros(3))
        np.testing.assert_allclose(point[0], axes, atol=1e-15)
    set_to = dict(line.split()[1:] for line in matrixkins_hal(c).splitlines()[1:])
    assert float(set_to['matrixkins.C_xy']) == pytest.approx(c[0, 1], abs=1e-12) == pytest.approx(3e-5, rel=1e-4)


def test_a_name_cannot_end_its_line():
    text = volume.volume_file(drawn_errors(), 'a\nlimit 1', TOOL, TRAVEL)
    assert sum(line.startswith('limit') for line in text.splitlines()) == 1


def test_a_file_is_read_back_as_it_was_written():
    errors = drawn_errors()
    again = volume.read_volume(volume.volume_file(errors, 'a', TOOL, TRAVEL, ORIGIN, 'XFYZ'))
    assert (again.chain, again.tool, again.travel) == ('XFYZ', TOOL, pytest.approx(TRAVEL, abs=1e-12))
    np.testing.assert_allclose(again.origin, ORIGIN, atol=1e-12)
    places = np.random.default_rng(5).uniform(0.0, TRAVEL, (40, 3))
    np.testing.assert_allclose(volume.field(again.errors, places, TOOL, TRAVEL, 'XFYZ'),
                               volume.field(errors, places, TOOL, TRAVEL, 'XFYZ'), atol=1e-14)
    # To first order what is taken off is the error at the place itself.
    np.testing.assert_allclose(again.taken_off(places), volume.field(errors, places, TOOL, TRAVEL, 'XFYZ'), atol=2e-8)


def test_half_a_file_is_not_read():
    text = volume.volume_file(drawn_errors(), 'a', TOOL, TRAVEL)
    with pytest.raises(StepdiagError, match='no whole solution file'):
        volume.read_volume(text[:-200])
