"""The how-to's code runs, block after block, and gives what it says."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / 'docs' / 'how-to' / 'methods_on_arrays.md'


def test_blocks_of_the_how_to():
    blocks = re.findall(r'```python\n(.*?)```', PAGE.read_text(), re.DOTALL)
    assert len(blocks) == 5
    space: dict = {}
    for block in blocks:
        exec(compile(block, str(PAGE), 'exec'), space)
    assert space['ebx'][-1] == pytest.approx(3e-6 * 0.8)
    assert space['found'].curve('ECX')[1][-1] == pytest.approx(5e-6 * 0.8)
    assert space['result'].B == pytest.approx(3e-6)
    assert space['value'] == pytest.approx(12e-6, abs=1e-10)
    assert space['solution'].status == 'ok'
    assert space['drawn'].shape == space['linear'].shape == (81,)
