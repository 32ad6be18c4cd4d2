"""What is brought up by a ``with`` statement, and stopped however that ends."""

from typing import Self


class BroughtUp:
    """``start`` on entering, ``stop`` on leaving or where the start fails; ``failed`` says that not all went well."""

    failed = False

    def __enter__(self) -> Self:
        try:
            self.start()
        except BaseException:
            self.failed = True
            self.stop()
            raise
        return self

    def __exit__(self, kind, *_exception) -> None:
        self.failed = self.failed or kind is not None
        self.stop()

    def start(self) -> None:
        """Bring up."""
        raise NotImplementedError

    def stop(self) -> None:
        """End everything; may be called again."""
        raise NotImplementedError
