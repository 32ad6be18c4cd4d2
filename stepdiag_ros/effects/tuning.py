"""Shape parameters tuned to a log: the tried time constants are a coarse net, a fit wants the best one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stepdiag_ros.effects.base import Effect, Form, StopView

GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


def tunable(form: Form, name: str, value: float, made: Callable[[float], Form]) -> Form:
    """A form with one shape parameter: its ``value``, and how it is ``made`` with another."""
    return replace(form, shape={name: value}, retune=lambda shape: made(shape[name]))


def tune(form: Form, score: Callable[[Form], float], within: float = 2.0, close: float = 1e-3) -> Form:
    """The form with the shape parameters for which ``score`` is largest, one after the other.

    Looks from ``1/within`` to ``within`` times each present value by golden section on the logarithm, until
    it is known to the share ``close``.  A form without such parameters, or one that cannot be
    bettered, is given back as it is.
    """
    if form.retune is None:
        return form
    best, reached = form, score(form)
    for name in form.shape:
        def at(step: float, name: str = name, start: Form = best) -> tuple[float, Form]:
            tried = start.at({**start.shape, name: start.shape[name] * float(np.exp(step))})
            return score(tried), tried

        low, high = -np.log(within), np.log(within)
        inner = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)]
        found = [at(step) for step in inner]
        while high - low > close:
            if found[0][0] >= found[1][0]:
                high, inner[1], found[1] = inner[1], inner[0], found[0]
                inner[0] = high - GOLDEN * (high - low)
                found[0] = at(inner[0])
            else:
                low, inner[0], found[0] = inner[0], inner[1], found[1]
                inner[1] = low + GOLDEN * (high - low)
                found[1] = at(inner[1])
        value, tried = max(found, key=lambda pair: pair[0])
        if value > reached:
            best, reached = tried, value
    return best


def same_form(effect: Effect, form: Form, view: StopView) -> Form:
    """``form`` of ``effect``, tuned as it is, laid at another view; itself where the view has none like it."""
    origin = form.tuned_from or form.label
    for other in effect.appearance(view):
        if other.label == origin:
            return other.at(form.shape) if form.tuned_from and other.retune is not None else other
    return form
