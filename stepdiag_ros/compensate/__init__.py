"""Tables for controls that cannot harm: what a control takes off, and what is left of the machine's errors then.

Start at :func:`stepdiag_ros.compensate.compensation.compensation`.
"""
