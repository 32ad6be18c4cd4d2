"""The numbers that decide, in one place, frozen before any log of others was answered.

Set on logs of our own making (``stepdiag blind seal --purpose develop``); docs/blind-check.md says
what they gave on logs sealed afterwards.
"""

ALARM = 8.0
"""Least log evidence of a set of effects against none for which anything is claimed, the prior odds against what has no
name on top: odds of a hundred to one for one cause of some twenty, and the same for what has none."""
SUSPICION = 6.0
"""Least log evidence of what is followed up on the way to a claim: a set to be fitted, a form to be tuned, an effect
that may bend the fit, a jump in a dwell, outlying arrivals; and by which what stood before must be better to stay."""
MEMBER_ALARM = 6.0
"""Least log evidence that each effect of a set must bring beside the others, the discrepancy of their forms allowed
for: odds of twenty against its prior probability."""
DISCREPANCY_SHARE = 0.05
"""Standard deviation of what an effect truly does about what its form does, as a share of it
(:mod:`stepdiag_ros.gap.inference.discrepancy`)."""
MISFIT = 0.03
"""Share of the log evidence of slow noise inside the dwells by which a line beside it must be better."""
LARGE_RESIDUAL = 5.0
"""Root mean square of the residuals, in times of the noise, that calls for a search of the place to begin at."""
LARGE_EVIDENCE = 1000.0
"""Log evidence (some 45 σ) from which an effect is tried in further forms of its own before others join it."""
FORM_ERROR = 0.1
"""Most of the variance of a correction of the 21 errors that stays uncertain because forms are not quite right, where
the log would let that pass: a third (0.1 = 0.32²) of the amplitude."""
LEAST_LEFT = 0.1
"""Share of the gap on held-out data that must be left, and be beyond chance, before it is spoken of."""
UNKNOWN_PENALTY = 8.0
"""Log odds against a shapeless pattern where a name explains as much."""
LEAN_PENALTY = 4.0
"""The same against a jump of no known cause."""
BEYOND_PENALTY = 0.0
"""The same against a lean pattern of physics that no effect has: it errs no more than a name's forms do, and is
one cause as an effect is one."""
BEYOND_WEIGHT = 9.0
"""Most effects as which such patterns weigh together, however many families they come in: so many families there were
when even odds were found right, on four sets for development."""
IMITATION_PENALTY = 3.0
"""The same against what has no name and does exactly what an effect does, but of any size, or what one does beside a
pattern without a name: one in twenty."""
CONTROL_SHARE = 0.2
"""Share of what an effect's negative controls explain by which a name must beat them."""
CONFUSED = 3.0
"""Sets closer than this in log evidence (odds of 20) are indistinguishable."""
VIBRATION_ALARM = 10.0
"""Least log evidence of lines in the dwells' spectrum: white noise passes 2 in one channel of a hundred, 4 in one of
600, 6 in one of 3000 (of 14,000 drawn), so this in about one of 10⁵."""
COHERENT_ALARM = 12.0
"""Least log evidence of lines that keep their phase from dwell to dwell; of logs without any one in twenty shows 4,
one in 10⁵ this."""
GROWS = 3.0
"""Log evidence from which a line counts as growing with the path."""
BACKGROUND_ALARM = 12.0
"""Least log evidence of smooth noise inside the dwells beyond white."""
LEAST_GROWTH = 0.75
"""Exponent with which the power of moving air grows with the path is 1 or more, that of shaking 0 …"""
GROWTH_SIGMAS = 5.0
"""… and it must be seen by so many standard deviations."""
NOISIER = 4.5
"""Times the noise that the description states from which a log is no longer believed to be of that machine: a maker's
statement is good to two, tails add 1.7 (Student's t with 3 degrees of freedom), and thirty repeats tell it to 1.3.  Of
more than a thousand nulls none showed 3."""
SCATTER_ALARM = 12.0
"""Least log evidence of scatter beyond the noise in any group of readings."""
KNOCKS_ALARM = 20.0
"""Least log evidence of knocks inside a few dwells: of 360 nulls, 300 of them with untidy noise, three showed 6 and
more, the most 14.4, so that about one in a thousand may show this (development set of seed 20270107, three others)."""
CLOCK_SIGMAS = 6.0
"""An offset of stamps must exceed this many of its standard deviations …"""
LEAST_CLOCK_S = 2.5e-3
"""… and this, what controls take to report in position."""
LEAST_SOONER_S = 1e-3
"""Motion seen longer than this before its command was published is no motion of this clock."""
DRIFT_SIGMAS = 8.0
"""A change of an offset in the course of the log must exceed this many of its standard deviations …"""
LEAST_DRIFT_S = 2e-4
"""… and this, what a warm control or a disciplined clock may change in an hour."""
PRIOR_RESET_M = 1e-4
"""Prior standard deviation [m] of the reset of a run that was not fitted: it is given free."""
LEAST_SHARE = 0.01
"""Cells with less of the excess than this are not named."""
CELL_SIGMAS = 3.0
"""… nor those whose excess noise alone could make, within this many standard deviations …"""
NAMED_CELL_SIGMAS = 1.0
"""… or this many where an effect that has a name makes it: that it acts is settled, and how much of it lies in a
cell is estimated without bias; a cell passed over is as wrong as one too many."""
LEAST_HOPS = 2
"""Fewest steps inside dwells, alike as shares of their lengths, that are taken for hops of the unit."""
