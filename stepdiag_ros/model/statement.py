"""What a cell's owner states of a test that no instrument tells: who, where, with what.

It travels in the cell description (key ``test``), stands on the test sheets that ISO 230-2 and ISO 230-6 ask for, and
enters no evaluation.  An older reader ignores it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.guard import limits

STATED = ('machine', 'instrument', 'detector', 'bed_temperature', 'place', 'person', 'warm_up', 'compensation')
"""Make and serial number of the machine; make, serial number and calibration of interferometer and detector;
temperature of the machine bed; place; person; warm-up before the test; what the control compensates."""
LETTERS = 200


@dataclass(frozen=True)
class Statement:
    """``said``: texts by key out of :data:`STATED`; ``feed`` [m/s] commanded where a setup has none of its own."""

    said: Mapping[str, str] = field(default_factory=dict)
    feed: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """The mapping of the contract; empty where nothing is stated."""
        return dict(self.said) | ({} if self.feed is None else {'feed': self.feed})


def text_problem(text: Any) -> str | None:
    """What is wrong with a stated text; None where it can stand on a sheet."""
    if not isinstance(text, str) or not text.strip():
        return 'is not a text; write a line in quotes'
    if len(text) > LETTERS or not text.isprintable():
        return f'must be one line of at most {LETTERS} letters'
    return None


def statement_of(get: Any, body: Any) -> Statement:
    """``test`` of a cell description; ``get`` reads checked values."""
    if body is None:
        return Statement()
    get.mapping(body, 'test')
    said = {key: body[key] for key in STATED if body.get(key) is not None}
    for key, text in said.items():
        if wrong := text_problem(text):
            raise StepdiagError(f'{get.source}: test.{key} {wrong}')
    feed = None if body.get('feed') is None else get.number(
        body, 'test.feed', minimum=limits.SLOWEST, maximum=limits.LENGTH_M)
    return Statement(said, feed)
