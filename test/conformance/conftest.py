"""What conformance tests share lies beside them, and the machine that is compensated beside its unit tests."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / 'unit' / 'linuxcnc')]
