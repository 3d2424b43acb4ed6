"""What the device needs of the hardware under it."""

from fabry_perot.hardware.instrument import Instrument, InstrumentError, Interrogation, Sampling

__all__ = ["Instrument", "InstrumentError", "Interrogation", "Sampling"]
