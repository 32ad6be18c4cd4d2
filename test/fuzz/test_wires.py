"""What passes between drivers and instruments, spoilt on its way: some attacks of the fuzzer, the same in every run."""

import random
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import wires


@pytest.fixture(scope='module')
def cell(tmp_path_factory):
    with wires.Wires(tmp_path_factory.mktemp('wires')) as running:
        yield running


@pytest.mark.parametrize('kind', wires.KINDS)
def test_neither_driver_nor_instrument_is_brought_down(cell, kind):
    """`make fuzz TIME=…` draws other attacks for as long as one likes."""
    said = [line for seed in range(12) for line in cell.turn(kind, random.Random(f'{kind}/{seed}'))]
    assert not said, said


def test_a_line_without_end_ends_the_connection_and_takes_no_memory(cell):
    """A control's client and the control alike give up on each other."""
    assert not cell.endless_line()
