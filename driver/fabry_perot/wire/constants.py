"""Protocol constants: message types, operations, results and flags."""

from __future__ import annotations

from enum import IntEnum

PROTOCOL = 2
"""Version of the messages; HELLO agrees on one."""

LASER_ARMED, LASER_EMITTING, SHUTTER_OPEN, INTERLOCK_CLOSED, KEY_ON = 1, 2, 4, 8, 16
"""Bits of ``Status.laser``."""
SAFE_BITS = INTERLOCK_CLOSED | KEY_ON
"""Without these two no laser may be armed."""
FAULT_INTERLOCK, FAULT_KEY, FAULT_SHUTTER = 1, 2, 3
"""Fault codes: interlock opened, or key turned off, while the laser was armed; light past a shutter told to close."""
SATURATED, MISTUNED, MISFIRE, PARTIAL_AVERAGE = 1, 2, 4, 8
"""Bits of ``ALineMeta.quality``."""
ALL_FRAGMENTS = 0xFF
"""In a missing list: the whole A-line."""
MAX_MISSING = 64
"""Longest missing list in one ALINE_ACK."""
MAX_GROUP = 255
"""Most A-lines in one frame."""
MOST_BEAMS = 64
"""Most interrogation beams of a scanner."""
FLAG_RETUNE, FLAG_MONITOR, FLAG_FIDUCIAL, FLAG_GATE = 1, 2, 4, 8
"""Bits of a point's ``flags``."""


class Type(IntEnum):
    """Message types; types with bit 7 set are sent by the device."""

    HELLO = 0x01
    CAPS = 0x02
    REQ = 0x03
    PLAN_DATA = 0x10
    ALINE_ACK = 0x20
    LEASE = 0x30
    ABORT = 0x31
    FAULT_ACK = 0x32
    HELLO_ACK = 0x81
    CAPS_PIECE = 0x82
    RSP = 0x83
    PLAN_STATUS = 0x90
    ALINE = 0xA0
    ALINE_GONE = 0xA1
    STATUS = 0xB0
    ABORT_ACK = 0xB1
    FAULT = 0xB2
    BUSY = 0xB3


class Operation(IntEnum):
    """Operations of a request (REQ); each is executed at most once per request id."""

    GET = 1
    SET = 2
    PLAN_NEW = 3
    ARM = 4
    START = 5
    PAUSE = 6
    PARK = 7
    TUNE_SCAN = 8
    DISARM = 9
    CLEAR_FAULT = 10
    RELEASE = 11


class Result(IntEnum):
    """Result code of a request."""

    OK = 0
    WRONG_STATE = 1
    OUT_OF_RANGE = 2
    BAD_TOKEN = 3
    NO_LEASE = 4
    UNKNOWN_OPERATION = 5
    STALE_REQUEST = 6
    MALFORMED = 7
    RING_NOT_EMPTY = 8
    NOT_SUPPORTED = 9
    HARDWARE_FAULT = 10


class AbortLevel(IntEnum):
    """Severity of an abort; each level includes the lower ones."""

    PAUSE = 1
    LASER_OFF = 2
    EMERGENCY_STOP = 3
