"""Text from outside, made fit for a terminal, a log or a page.

Names in a log, a cell file or an instrument's answer may hold escape sequences that move a terminal's cursor or
change its title, and characters that turn the direction of writing.  They are shown as ``\\x1b`` and the like.
"""

import re
from typing import Any, TextIO

#: Control characters but tab and newline, and those that change the direction or break a line unseen.
UNFIT = re.compile('[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]')


def escaped(text: str) -> str:
    """``text`` with every character that is not for reading written as its code."""
    return UNFIT.sub(lambda found: _code(ord(found[0])), text)


def _code(number: int) -> str:
    return f'\\x{number:02x}' if number < 0x100 else f'\\u{number:04x}'


class SafeStream:
    """A text stream that shows what is written to it :func:`escaped`; the rest is the ``stream``'s own.

    ``control(text)`` writes as it is: for the program's own carriage returns.
    """

    def __init__(self, stream: TextIO):
        self._stream = stream

    def write(self, text: str) -> int:
        self._stream.write(escaped(text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        for line in lines:
            self.write(line)

    def control(self, text: str) -> None:
        self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
