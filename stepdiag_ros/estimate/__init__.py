"""Estimators: one file a method, one result type."""

from stepdiag_ros.estimate.evaluate import evaluate
from stepdiag_ros.estimate.solution import Solution

__all__ = ['Solution', 'evaluate']
