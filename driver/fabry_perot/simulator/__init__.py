"""An honest simulator of the scanner, run as a process of its own.

``python -m fabry_perot.simulator --pty`` is the command, :func:`launch` starts that very command.
"""

from fabry_perot.simulator.launcher import Simulator, launch
from fabry_perot.simulator.options import Options

__all__ = ["Options", "Simulator", "launch"]
