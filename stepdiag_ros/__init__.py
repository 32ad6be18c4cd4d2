"""In-machine calibration of three-axis machine tools by the enhanced laser step diagonal method."""

import os

# The matrices here are small: one thread is fastest, leaves the cell's other processes their
# cores, and makes results bit-identical whatever the machine.  Must precede NumPy's import.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
