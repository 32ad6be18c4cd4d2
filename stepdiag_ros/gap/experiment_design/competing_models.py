"""Sets of effects that the log leaves open, and the forms in which a further run is to tell them apart."""

from collections.abc import Iterable, Mapping

import numpy as np

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.gap.alternatives.known_physics import Beyond
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import CONFUSED
from stepdiag_ros.gap.experiment_design.extended_log import Ways, kind
from stepdiag_ros.gap.inference.candidates import Screen
from stepdiag_ros.gap.inference.search import EffectSet

OTHER_WAYS = 2
LEAST_WAY = 0.05
"""Most further forms of an effect in which a set of effects is predicted, and the least share of one."""
BEYOND_LOG = 0.3
"""Power of a form's odds beyond the log: the form that suits best there need not be that in which things go on."""


def confused(sets: list[EffectSet], best: EffectSet) -> tuple[tuple[str, ...], ...]:
    """Groups of effects that may stand for each other."""
    merged: dict[str, set] = {}
    for other in _stand_ins(sets, best):
        for member in best.key - other.key:
            merged.setdefault(member, {member}).update(other.key - best.key)
    return tuple(tuple(sorted(g)) for g in merged.values())


def separations(sets: list[EffectSet], best: EffectSet) -> dict[str, float]:
    """How well the log separates from the best set what may stand for a member of it.

    By name the log evidence by which that falls behind; 0: not at all, ``CONFUSED``: it would be distinguished.
    """
    found: dict[str, float] = {}
    for other in _stand_ins(sets, best):
        for name in other.key - best.key:
            found[name] = min(found.get(name, np.inf), best.log_bayes - other.log_bayes)
    return found


def competing_models(screen: Screen, effects: Mapping[str, Effect], sets: list[EffectSet], best: EffectSet,
              groups: Iterable[Iterable[str]], hint: bool = False) -> list[Ways]:
    """The best set and those that it may be taken for, each with the ways in which it may act; those are left out of
    which it is not known what they would do in a further run.  A ``hint`` may be nothing as well; none where it is not
    known what that itself would do."""
    known = {**effects, UNKNOWN: Beyond()}
    if hint:
        groups = (*groups, best.key)
    found = [_ways(screen, known, found, groups)
             for found in (best, *_stand_ins(sets, best)) if _predicts(screen, found)]
    if not hint:
        return found
    return [*found, [(1.0, [])]] if _predicts(screen, best) else []


def _stand_ins(sets: list[EffectSet], best: EffectSet) -> list[EffectSet]:
    """Sets nearly as good as the best with one member exchanged."""
    return [other for other in sets
            if not other.refused and len(other.key) == len(best.key) and len(best.key - other.key) == 1
            and UNKNOWN not in other.key and best.log_bayes - other.log_bayes < CONFUSED]


def _predicts(screen: Screen, found: EffectSet) -> bool:
    """Whether it is known what a set would do in a further run: a shapeless pattern's is not."""
    return all(m.effect != UNKNOWN or screen.candidates[m.candidate].own for m in found.members)


def _ways(screen: Screen, effects: Mapping[str, Effect], found: EffectSet,
          groups: Iterable[Iterable[str]]) -> Ways:
    """A set with the forms that the member which another may stand for can take nearly as well."""
    forms = [(effects[m.effect], screen.candidates[m.candidate].form) for m in found.members]
    doubtful = {name for group in groups for name in group}
    ways = [(found.log_bayes, forms)]
    for k, member in enumerate(found.members):
        rest = found.members[:k] + found.members[k + 1:]
        if member.effect not in doubtful or any(m.effect == member.effect for m in rest):
            continue
        numbers = [i for i, c in enumerate(screen.candidates) if c.effect == member.effect]
        evidence = screen.judge_all(rest, numbers).log_bayes
        # Of each kind of form one: time constants next to each other say the same.
        kinds = {kind(screen.candidates[i].form): i for i in sorted(numbers, key=lambda i: evidence[i])}
        others = [i for name, i in reversed(kinds.items()) if name != kind(forms[k][1])]
        ways += [(found.log_bayes + float(evidence[i] - evidence[member.candidate]),
                  [*forms[:k], (effects[member.effect], screen.candidates[i].form), *forms[k + 1:]])
                 for i in others[:OTHER_WAYS]]
    shares = np.exp([BEYOND_LOG * (log - max(log for log, _ in ways)) for log, _ in ways])
    shares[shares < LEAST_WAY * shares.sum()] = 0.0
    return [(float(share), members) for share, (_, members) in zip(shares / shares.sum(), ways, strict=True) if share]
