"""Hardware abstraction: component protocols and the apparatus that combines them."""

from fabry_perot.hardware.apparatus import Apparatus
from fabry_perot.hardware.calibration import GalvoCalibration, time_zero
from fabry_perot.hardware.instrument import Instrument, InstrumentError, Interrogation, Sampling
from fabry_perot.hardware.roles import (
    Digitiser,
    ExcitationLaser,
    Galvo,
    GatedLaser,
    InterrogationLaser,
    Path,
    Record,
    Shutter,
)

__all__ = [
    "Apparatus",
    "Digitiser",
    "ExcitationLaser",
    "Galvo",
    "GalvoCalibration",
    "GatedLaser",
    "Instrument",
    "InstrumentError",
    "Interrogation",
    "InterrogationLaser",
    "Path",
    "Record",
    "Sampling",
    "Shutter",
    "time_zero",
]
