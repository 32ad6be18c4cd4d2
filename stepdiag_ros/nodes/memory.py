"""What a computation has freed goes back to the system.

The allocator of glibc keeps freed memory for the thread that used it, and a diagnosis is made in a thread of its own:
a node that diagnoses once an hour would hold the peak of several.
"""

import ctypes
from contextlib import suppress

_LIBC = ctypes.CDLL(None)


def give_back() -> None:
    """Return free pages of all arenas; does nothing where the C library cannot."""
    with suppress(AttributeError):      # not glibc
        _LIBC.malloc_trim(0)
