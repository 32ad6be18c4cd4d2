"""The gap between log and simulator: where it lies, which effect causes it, how far it closes."""

from stepdiag_ros.gap.diagnose import diagnose
from stepdiag_ros.gap.diagnosis import Diagnosis

__all__ = ['Diagnosis', 'diagnose']
