"""Film response of the simulated scanner, shared with the driver's simulator."""

from fabry_perot.simulator.film import directivity as angular_response
from fabry_perot.simulator.film import low_pass as band_limited

__all__ = ["angular_response", "band_limited"]
