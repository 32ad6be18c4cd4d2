"""The controls that tables can be written for, by name."""

from collections.abc import Mapping

from stepdiag_ros.compensate import (
    etalon,
    heidenhain,
    isg,
    linuxcnc,
    linuxcnc_matrix,
    linuxcnc_volume,
    sinumerik,
)
from stepdiag_ros.compensate.control import Control

CONTROLS: Mapping[str, Control] = {module.CONTROL.name: module.CONTROL
                                   for module in (linuxcnc, linuxcnc_matrix, linuxcnc_volume, sinumerik, heidenhain,
                                                  etalon, isg)}
