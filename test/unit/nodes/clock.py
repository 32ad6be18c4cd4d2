"""A clock that stands until a test moves it."""


class Clock:
    """Called it says ``s`` [s], as ``time.monotonic`` does."""

    def __init__(self) -> None:
        self.s = 100.0

    def __call__(self) -> float:
        return self.s
