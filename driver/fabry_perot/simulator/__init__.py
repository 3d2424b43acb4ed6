"""Scanner simulator that runs as a separate process.

``python -m fabry_perot.simulator --pty`` is the command, :func:`launch` starts that very command.
"""

from fabry_perot.simulator.launcher import Simulator, launch
from fabry_perot.simulator.options import Options

__all__ = ["Options", "Simulator", "launch"]
