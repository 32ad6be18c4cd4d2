"""The gap between log and simulator: where it lies, which effect causes it, how far it closes."""

from stepdiag_ros.gap.diagnose import Diagnosis, diagnose

__all__ = ['Diagnosis', 'diagnose']
