"""What a check of a log found."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One recognised mistake: its short ``name``, what was ``found`` with numbers, and what to ``change``."""

    name: str
    found: str
    change: str

    def __str__(self) -> str:
        return f'{self.found}: {self.change}'

    def to_json_dict(self) -> dict[str, str]:
        return {'name': self.name, 'found': self.found, 'change': self.change}
