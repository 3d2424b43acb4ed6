"""Host side of the protocol: a state machine without I/O, transports, and the driver for applications."""

from fabry_perot.host.auto_recovery import RecoveryPolicy, ScanRecovery
from fabry_perot.host.host import Host
from fabry_perot.host.plan import WirePlan
from fabry_perot.host.shot_accounting import ScanReport
from fabry_perot.host.timing import HostTiming

__all__ = ["Host", "HostTiming", "RecoveryPolicy", "ScanRecovery", "ScanReport", "WirePlan"]
