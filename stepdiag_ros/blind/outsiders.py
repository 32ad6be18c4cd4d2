"""Which effects from outside the vocabulary there are: the usual ones, all that were met, and those that were not.

A kind counts as met once somebody has looked at why an answer to it is what it is: what the diagnosis knows may have
grown towards it since.  Only kinds that were not tell how far it reaches beyond what its makers thought of.
"""

from stepdiag_ros.blind.outside import OUTSIDE
from stepdiag_ros.blind.outside_cells import CELLS
from stepdiag_ros.blind.outside_field import FIELD
from stepdiag_ros.blind.outside_more import MORE
from stepdiag_ros.blind.outside_shopfloor import SHOPFLOOR
from stepdiag_ros.blind.outside_unseen import UNSEEN
from stepdiag_ros.blind.outside_works import WORKS
from stepdiag_ros.blind.outside_workshop import WORKSHOP

USUAL = OUTSIDE
MET = (*OUTSIDE, *MORE, *CELLS, *UNSEEN, *SHOPFLOOR, *FIELD, *WORKS)
UNMET = WORKSHOP
OUTSIDERS = (*MET, *UNMET)
