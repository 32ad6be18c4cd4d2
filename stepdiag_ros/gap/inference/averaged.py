"""The 21 errors with the effects taken out, and how uncertain that leaves them.

What an effect takes of the errors depends on the form that it is given, and forms that explain a log as well as
each other may take different things: a motion that depends on two axes' places can be laid to either.  So may a
profile whose size the log hardly shows.  The errors are therefore averaged over forms and sizes by their evidence;
their variance is the mean of the forms' own and the variance between them (law of total variance).  A pattern without a
name is weighed against the names that may stand for it.  What may act beside an effect, as large and unseen, is as
uncertain as that: a machine that is seen to bend in one motion bends in others.  No form of the list is right to the
last part either: of each correction a share remains uncertain that the log would let pass unseen.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.estimate.enhanced import Fit
from stepdiag_ros.estimate.evaluate import solution_of
from stepdiag_ros.estimate.gauge import reporting_matrix
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.standing import with_standing
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import FORM_ERROR
from stepdiag_ros.gap.inference.candidates import Known, Member, Screen
from stepdiag_ros.gap.inference.joint import (
    Active,
    Joint,
    held_to_sizes,
    inverse,
    prior_sigmas,
    size_of,
    solve,
    unexplained,
)
from stepdiag_ros.gap.inference.search import EffectSet

WITHIN = 5.0
"""Compositions this far behind the best in log evidence (odds of 150) have no part in the average …"""
MOST = 16
"""… nor have those beyond so many."""


def compositions(screen: Screen, best: EffectSet) -> list[EffectSet]:
    """Sets of as many forms as ``best`` has that explain the log nearly as well, its forms exchanged one by one."""
    forms = Counter(candidate.effect for candidate in screen.candidates)
    ways = np.log([forms[candidate.effect] for candidate in screen.candidates])
    sets = [best]
    for place, member in enumerate(best.members):
        if member.effect == UNKNOWN and any(m.effect == UNKNOWN for m in best.members[place + 1:]):
            continue  # its evidence is that beside those found before it
        grown: dict[frozenset, EffectSet] = {}
        for found in sets:
            rest = found.members[:place] + found.members[place + 1:]
            taken = {m.candidate for m in rest}
            fitting = [number for number, candidate in enumerate(screen.candidates)
                       if number not in taken and candidate.effect != UNKNOWN and not candidate.negative_control]
            known = screen.judge_all(rest, fitting)
            evidence = known.log_bayes - ways
            now = member.log_bayes - member.penalty if member.effect == UNKNOWN else evidence[member.candidate]
            log_bayes = found.log_bayes - now + evidence
            others = [EffectSet((*found.members[:place], _as_member(screen, number, known),
                                 *found.members[place + 1:]), float(log_bayes[number]))
                      for number in fitting if number != member.candidate
                      and log_bayes[number] > found.log_bayes - WITHIN]
            for larger in (found, *others):
                key = frozenset(m.candidate for m in larger.members)
                if key not in grown or grown[key].log_bayes < larger.log_bayes:
                    grown[key] = larger
        leading = sorted(grown.values(), key=lambda s: -s.log_bayes)[:MOST]
        sets = [s for s in leading if s.log_bayes > leading[0].log_bayes - WITHIN]
    return sets


def _as_member(screen: Screen, number: int, known: Known) -> Member:
    """A candidate as a member of a set."""
    return Member(screen.candidates[number].effect, number, 0.0, screen.allowed(number, known))


def averaged_solution(joint: Joint, screen: Screen, best: EffectSet) -> Solution:
    """The machine's errors with the effects taken out, averaged over the forms that these may have."""
    table = joint.observation.table
    result, pull, rest = averaged_fit(joint, screen, best)
    solution = solution_of(replace(result, covariance=result.louder * result.covariance + _of_weights(joint)), table)
    if joint.active:
        solution = replace(solution, covariance=solution.covariance + np.diag(_allowance(joint, pull, rest)))
    return with_standing(solution, joint.fit, table)


def averaged_fit(joint: Joint, screen: Screen, best: EffectSet) -> tuple[Fit, np.ndarray, np.ndarray]:
    """The fit at the mean of the forms, its covariance theirs and what is between them; what the effects do to the
    unknowns (size,); the stops' white residuals."""
    rest = unexplained(joint.parity, joint.active)[:joint.parity.stops]
    result = replace(joint.fit, chi2=float(rest @ rest), dof=joint.parity.dof[0])
    if not joint.active:
        return result, np.zeros(len(result.theta)), rest
    pull, covariance = _pull(joint, joint.active)
    other = compositions(screen, best)
    fitted = [(np.exp(c.log_bayes - other[0].log_bayes) * share, active)
              for c in other for share, active in _fitted(joint, screen, c)]
    if len(fitted) > 1 or len(fitted[0][1]) > len(joint.active):
        weight = np.array([w for w, _ in fitted])
        weight /= weight.sum()
        parts = [_pull(joint, active) for _, active in fitted]
        shift = np.array([pull - p for p, _ in parts])
        mean = weight @ shift
        away = (shift - mean) * np.sqrt(weight)[:, None]
        covariance = sum(w * c for w, (_, c) in zip(weight, parts, strict=True)) + away.T @ away
        result = replace(result, theta=result.theta + mean)
        pull = pull - mean
    return replace(result, covariance=covariance), pull, rest


def _fitted(joint: Joint, screen: Screen, found: EffectSet) -> list[tuple[float, tuple[Active, ...]]]:
    """The effects, and what may act beside them, at each size that the log leaves them, with its probability."""
    chosen: list[tuple[Effect, Form]] = [(Effect(), screen.candidates[m.candidate].form) for m in found.members]
    return [(share, solve(joint.parity, [*held, *_beside(held)]))
            for share, held in held_to_sizes(joint.parity, chosen)]


def _beside(held: Sequence[tuple[Effect, Form]]) -> list[tuple[Effect, Form]]:
    """What may act beside forms that are held to their sizes: all of it together as large as each of them."""
    return [(effect, replace(form.beside, held=size_of(form) / np.sqrt(len(form.beside.columns))))
            for effect, form in held if form.beside is not None]


def _pull(joint: Joint, active: Sequence[Active]) -> tuple[np.ndarray, np.ndarray]:
    """What effects, if not taken out, do to the unknowns (size,), and the unknowns' covariance beside them."""
    size = np.concatenate([a.coefficients / a.form.scale for a in active])
    columns = np.concatenate([np.asarray(a.form.columns) * a.form.scale[:, None, None] for a in active])
    white = joint.whitened(columns.reshape(len(columns), -1).T)
    along = joint.along(white)
    follow = joint.followed(along)
    left = white.T @ white - along.T @ follow
    spread = inverse(left + np.diag(prior_sigmas(a.form for a in active) ** -2.0))
    return follow @ size, inverse(joint.normal) + follow @ spread @ follow.T


def _of_weights(joint: Joint) -> np.ndarray:
    """Covariance (size, size) of the unknowns that the arrivals' weights add, which no one gave: the log did.

    Errors of Student's t with ν degrees of freedom tell of a mean (ν + 1)/(ν + 3) of what they would with their weights
    given (Lange, Little & Taylor 1989, the expected information).
    """
    laws = [joint.noise.angle_law] * 2 + [joint.noise.position_law] * 3
    lost = np.array([2.0 / (law.dof + 1.0) for law in laws])
    total = np.zeros_like(joint.normal)
    if joint.noise.has_tails:
        spread = inverse(joint.normal)
        for run, latent in enumerate(joint.latents()):
            moved = spread @ joint.along(latent.columns, run) * np.sqrt(lost[latent.source])
            total += moved @ latent.prior @ moved.T
    return total


def _allowance(joint: Joint, pull: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Variance (p,) of the reported values because the effects' forms are not quite right.

    The share of their variance by which the forms may err without the log telling: what is left beyond
    its expectation, and one standard deviation of that, over what they explain.  It is taken to be as large in
    what the fit absorbs, evenly over each curve.
    """
    data, dof = joint.parity.data[:joint.parity.stops], joint.parity.dof[0]
    explained = max(float(data @ data - rest @ rest), 1e-12)
    share = min((max(float(rest @ rest) - dof, 0.0) + np.sqrt(2.0 * dof)) / explained, FORM_ERROR)
    parameters = joint.fit.parameters
    names, reporting = reporting_matrix(parameters.knots, parameters.first, parameters.size)
    square = (reporting @ pull) ** 2
    result = np.zeros(len(square))
    for name in {n for n, _ in names}:
        rows = np.flatnonzero([n == name for n, _ in names])
        moving = rows[np.any(reporting[rows] != 0.0, axis=1)]
        if len(moving):
            result[moving] = share * square[moving].mean()
    return result
