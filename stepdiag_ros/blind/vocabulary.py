"""The nineteen effects of the contract as the sealed world has them."""

from stepdiag_ros.blind.forms_detector import (
    AmbientLight,
    PsdGain,
    PsdNonlinearity,
    PsdRotation,
    PsdZeroOffset,
)
from stepdiag_ros.blind.forms_instrument import (
    AirRefractionDrift,
    BeamPointingDrift,
    CountSlip,
    CyclicNonlinearity,
    MirrorCurvature,
    MirrorMountCreep,
)
from stepdiag_ros.blind.forms_machine import (
    Backlash,
    ClockSkew,
    NonRigidCoupling,
    ScaleThermalExpansion,
    ServoSettling,
    SquarenessDrift,
    StructuralThermalDrift,
    Vibration,
)

VOCABULARY = (AirRefractionDrift, CyclicNonlinearity, CountSlip, BeamPointingDrift, MirrorCurvature,
              MirrorMountCreep, PsdZeroOffset, PsdGain, PsdNonlinearity, PsdRotation, AmbientLight,
              ScaleThermalExpansion, StructuralThermalDrift, Backlash, ServoSettling,
              NonRigidCoupling, SquarenessDrift, Vibration, ClockSkew)
NAMES = tuple(kind.name for kind in VOCABULARY)
