"""Between nothing and a finding: what was worth following up and is not enough for a claim."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stepdiag_ros.gap.constants import SUSPICION
from stepdiag_ros.gap.inference.candidates import Screen
from stepdiag_ros.gap.inference.search import EffectSet, log_prior


@dataclass(frozen=True)
class Hint:
    """A set of effects of which nothing is claimed; ``forms``: what each looks like, by name; ``settles``: the log
    evidence that either makes a finding of it or leaves it no likelier than nothing."""

    found: EffectSet
    forms: Mapping[str, str]
    settles: float

    def to_json_dict(self) -> dict:
        return {'names': list(self.forms), 'forms': list(self.forms.values()), 'log_evidence': self.found.log_bayes,
                'claimed_from': self.found.claimed_from}


def hint_of(sets: Sequence[EffectSet], effects: int, screen: Screen) -> Hint | None:
    """The hint in the ``sets`` thought of, best first, of ``effects`` possible ones; None where none is worth it."""
    found, none = sets[0], EffectSet((), 0.0)
    ahead = found.log_bayes + log_prior(found, effects) - log_prior(none, effects)
    if found.log_bayes < SUSPICION or ahead <= 0.0:
        return None
    # Of several forms the first explains the most.
    forms = {m.effect: screen.candidates[m.candidate].form.label for m in reversed(found.members)}
    return Hint(found, {name: forms[name] for name in dict.fromkeys(found.names)},
                max(found.claimed_from - found.log_bayes, ahead))
