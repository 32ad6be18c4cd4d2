"""Start a cell and watch over it until Ctrl-C.

Starts the virtual cell of the file (or, with --hardware, connects to the instruments it
names), the machine's nodes, and brings them to active.  A node that dies is started
again, and that is reported.  Ctrl-C ends every process and leaves a whole bag.
"""

from stepdiag_ros.nodes import bringup

NAME = 'up'
HELP = 'start a cell from its YAML file and watch over it until Ctrl-C'
add_arguments = bringup.add_arguments
run = bringup.run
