"""What to measure next, in words and as a run that can be done.

Where effects stand for each other, or it is in doubt that any acts, the further run that tells best is computed
(:mod:`stepdiag_ros.gap.experiment_design.next_run`).  Where no run of the same kind does, there is a well-known
trick for some pairs, which follows from what the effects are.
"""

from collections.abc import Sequence

from stepdiag_ros.gap.experiment_design.extended_log import Ways
from stepdiag_ros.gap.experiment_design.next_run import NextRun, recommend
from stepdiag_ros.gap.inference.joint import Joint
from stepdiag_ros.model.description import LINEAR, path_of

WORTH = 3.0
"""A further run is advised from this expected log evidence: from even odds to 95 %; one that
begins right after mounting may bring more than its forecast counts on."""

SPECIAL = {
    frozenset({'psd_gain', 'ambient_light'}):
        'Switch the light off or cover the detector and repeat one diagonal: '
        'a wrong gain stays, background light goes.',
    frozenset({'psd_zero_offset', 'mirror_curvature'}):
        'Shift the position sensor by 1 mm and repeat one diagonal: an offset of the zero follows by 1 mm.',
    frozenset({'servo_settling', 'vibration'}):
        'Repeat one diagonal with a dwell three times as long: settling dies away, vibration does not.',
    frozenset({'backlash', 'servo_settling'}):
        'Repeat one diagonal with a dwell three times as long: settling dies away, backlash does not.',
    frozenset({'scale_thermal_expansion', 'air_refraction_drift'}):
        'Log the temperatures of the scales and of the air during one further diagonal.',
}
"""Pairs that one well-known trick separates where no run of the same kind does."""

FOR_UNKNOWN = ('Repeat the {path} with the largest share of the gap at once and again after half an hour: '
               'what stays belongs to the place, what changes belongs to time.')

FOR_HINT = 'Do the whole calibration once more: what acts will speak as loud again, what was chance will not.'
"""Where no single run settles a hint."""


def advise(joint: Joint, models: Sequence[Ways], groups: Sequence[Sequence[str]],
           unknown: bool, settles: float | None = None) -> tuple[str | None, NextRun | None]:
    """The advice in words, or None where nothing is left to tell apart; the run, where one is worth it.

    ``models``: the likeliest set of effects in the forms that it may take, then those that may stand for it, or
    nothing; ``groups``: names that are indistinguishable; ``unknown``: whether something acts that has no name;
    ``settles``: where it is in doubt that anything does, the log evidence that would settle it.
    """
    run = recommend(joint, models)
    if run is not None and (run.at_once or run.evidence >= (WORTH if settles is None else settles)):
        return run.text, run
    if settles is not None:
        return FOR_HINT, None
    for group in groups:
        for pair, text in SPECIAL.items():
            if pair <= set(group):
                return text, run
    lines = all(path_of(name) in LINEAR for name in joint.observation.table.setup_names)
    repeat = FOR_UNKNOWN.format(path='line' if lines else 'diagonal')
    return (run.text if run else repeat if unknown or groups else None), run
