"""Every set of effects that was weighed: its evidence, its prior, whether it may be claimed and why not."""

from collections.abc import Sequence
from dataclasses import dataclass

from stepdiag_ros.gap.inference.candidates import Screen
from stepdiag_ros.gap.inference.search import EffectSet, log_prior, probabilities

MOST = 25
"""Most sets that are listed."""


@dataclass(frozen=True)
class Weighed:
    """``names`` of a set, the ``forms`` of its members, ``log_evidence`` against nothing, ``log_prior``,
    ``probability`` among the sets that may be claimed, and why it is ``refused`` ('' if it is not)."""

    names: tuple[str, ...]
    forms: tuple[str, ...]
    log_evidence: float
    log_prior: float
    probability: float
    refused: str

    def to_json_dict(self) -> dict:
        return {'names': list(self.names), 'forms': list(self.forms), 'log_evidence': self.log_evidence,
                'log_prior': self.log_prior, 'probability': self.probability, 'eligible': not self.refused,
                'refused': self.refused or None}


def weighed(sets: Sequence[EffectSet], effects: int, screen: Screen) -> tuple[Weighed, ...]:
    """The sets by evidence and prior, the best first, those that may not be claimed among them."""
    _, _, weights = probabilities(sets, effects)
    rows = []
    for found, weight in zip(sets, weights, strict=True):
        refused = found.refused
        if not refused and found.members and found.log_bayes < found.claimed_from:
            refused = f'log evidence below {found.claimed_from:.0f}, what a claim takes'
        rows.append(Weighed(tuple(m.effect for m in found.members),
                            tuple(screen.candidates[m.candidate].form.label for m in found.members),
                            found.log_bayes, log_prior(found, effects), weight, refused))
    return tuple(sorted(rows, key=lambda row: -(row.log_evidence + row.log_prior))[:MOST])


def table(rows: Sequence[Weighed]) -> str:
    """The rows as text, for a terminal."""
    lines = ['  log evidence  log prior  probability  set (forms)']
    for row in rows:
        names = ' + '.join(row.names) or 'nothing'
        forms = f' ({"; ".join(row.forms)})' if row.forms else ''
        numbers = f"  {row.log_evidence:12.2f}  {row.log_prior:9.2f}  {100.0 * row.probability:9.2f} %"
        lines.append(f"{numbers}  {names}{forms}")
        if row.refused:
            lines.append(f'{"":41}not eligible: {row.refused}')
    return '\n'.join(lines)
