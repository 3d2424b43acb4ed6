"""Hardware abstraction: component interfaces and the instrument composed of them."""

from fabry_perot.hardware.calibration import GalvoCalibration, time_zero
from fabry_perot.hardware.components import (
    BeamPath,
    Digitiser,
    ExcitationLaser,
    Galvo,
    GatedLaser,
    InterrogationLaser,
    Shutter,
    TriggerRecord,
)
from fabry_perot.hardware.composed import ComposedInstrument
from fabry_perot.hardware.instrument import Instrument, InstrumentError, PlanSampling, PointRecord

__all__ = [
    "BeamPath",
    "ComposedInstrument",
    "Digitiser",
    "ExcitationLaser",
    "Galvo",
    "GalvoCalibration",
    "GatedLaser",
    "Instrument",
    "InstrumentError",
    "InterrogationLaser",
    "PlanSampling",
    "PointRecord",
    "Shutter",
    "TriggerRecord",
    "time_zero",
]
