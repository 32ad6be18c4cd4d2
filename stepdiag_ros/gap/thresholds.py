"""The numbers that decide, in one place, frozen before any log of others was answered.

Set on logs of our own making (``stepdiag blind seal --purpose develop``); docs/blind-check.md says
what they gave on logs sealed afterwards.
"""

ALARM = 6.0
"""Least log evidence of a set of effects against none for which anything is claimed."""
MEMBER_ALARM = 6.0
"""Least log evidence of one more effect given those before it …"""
MISFIT = 0.03
"""… plus this share of theirs, which forms that are not quite right may leave over."""
MISFIT_MOST = 12.0
"""… but not more than this."""
STOP_SUPPORT = 2.0
"""Least log evidence in the stops' means alone for a further slow effect."""
UNKNOWN_DOUBT = 8.0
"""Log odds against a shapeless pattern of no name where a name explains as much."""
LEAN_DOUBT = 4.0
"""The same against a nameless jump."""
BEYOND_DOUBT = 1.0
"""The same against a lean pattern of physics that no effect has: it errs no more than a name's forms do."""
TEMPER = 1.0
"""Factor on log evidence before it becomes odds."""
CONFUSED = 3.0
"""Sets closer than this in log evidence (odds of 20) cannot be told apart."""
VIBRATION_ALARM = 8.0
"""Least log evidence of a spectral line."""
SCATTER_ALARM = 12.0
"""Least log evidence of scatter beyond the noise in any group of readings."""
CLOCK_SIGMAS = 6.0
"""An offset of stamps must exceed this many of its standard deviations …"""
LEAST_CLOCK_S = 2.5e-3
"""… and this, what controls take to report in position."""
LEAST_SHARE = 0.01
"""Cells with less of the excess than this are not named."""
