"""What drive and host have in common in CANopen: objects, identifiers, states.

Sources: CiA 301 and CiA 402 (IEC 61800-7-201).
"""

import struct

NMT, SYNC = 0x000, 0x080  # identifiers; those of a node follow, to be added to its number
TPDO1, RPDO1, TPDO2, ANSWER, REQUEST, HEARTBEAT = 0x180, 0x200, 0x280, 0x580, 0x600, 0x700
START, PRE_OPERATIONAL = 0x01, 0x80  # commands of network management
OPERATIONAL = 0x05  # state in a heartbeat

CONSUMER_HEARTBEAT = (0x1016, 1)  # u32: node of the producer << 16 | time [ms]
ON_LOST_HOST = (0x6007, 0)  # i16: 1 is a fault
ON_FAULT = (0x605E, 0)  # i16: 0 takes the power away at once
MODE = (0x6060, 0)  # i8
MODE_SHOWN = (0x6061, 0)  # i8
TORQUE_MODE = 10  # cyclic synchronous
RATED_TORQUE = (0x6076, 0)  # u32 [mN m]
ERROR_CODE = (0x603F, 0)  # u16

PDOS = {  # parameters, and objects as index << 16 | subindex << 8 | bits
    RPDO1: ((0x1400, 0x1600), (0x60400010, 0x60710010)),  # controlword, target torque
    TPDO1: ((0x1800, 0x1A00), (0x60410010, 0x60640020, 0x60770010)),  # statusword, position, torque
    TPDO2: ((0x1801, 0x1A01), (0x10130020,)),  # high resolution time stamp [us]
}
COMMAND = struct.Struct("<Hh")  # RPDO1
STATE = struct.Struct("<Hih")  # TPDO1
STAMP = struct.Struct("<I")  # TPDO2
AT_ONCE, AT_SYNC = 255, 1  # transmission types
INVALID = 0x80000000  # bit of an identifier while its PDO is laid out
NO_REMOTE = 0x40000000  # bit of a TPDO's identifier: it is not asked for by remote frames, which many drives cannot do

SDO = struct.Struct("<BHB4s")  # command, index, subindex, value: of a transfer whose value fits into one message
UPLOAD, UPLOADED, DOWNLOAD, DOWNLOADED, ABORTED = 0x40, 0x43, 0x23, 0x60, 0x80

SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE, FAULT_RESET = 0x06, 0x07, 0x0F, 0x00, 0x80  # controlwords
STATES = (  # mask and value of the statusword, and the controlword that leads on towards operation
    (0x4F, 0x40, "switch-on disabled", SHUTDOWN),
    (0x6F, 0x21, "ready to switch on", SWITCH_ON),
    (0x6F, 0x23, "switched on", ENABLE),
    (0x6F, 0x27, "operation enabled", ENABLE),
    (0x6F, 0x07, "quick stop", DISABLE_VOLTAGE),
    (0x4F, 0x0F, "fault reaction", FAULT_RESET),
    (0x4F, 0x08, "fault", FAULT_RESET),
)
ENABLED = "operation enabled"
ERRORS = {  # of those that a drive may report, CiA 402 table of error codes
    0x2310: "over-current",
    0x3210: "over-voltage of its supply",
    0x3220: "under-voltage of its supply",
    0x4310: "over-temperature of the drive",
    0x7305: "encoder signal lost",
    0x8130: "it did not hear of this computer in time and took the power away",
}


def state(statusword: int) -> tuple[str, int]:
    """Name of a drive's state, and the controlword that leads on towards operation."""
    for mask, value, name, onwards in STATES:
        if statusword & mask == value:
            return name, onwards
    return "not ready to switch on", DISABLE_VOLTAGE


def pack_sdo(command: int, where: tuple[int, int], value: bytes = b"") -> bytes:
    """A request for an object or an answer to one, with up to four bytes of value."""
    unused = 4 - len(value) if command in (UPLOADED, DOWNLOAD) else 0
    return SDO.pack(command | unused << 2, *where, value)


def unpack_sdo(data: bytes) -> tuple[int, tuple[int, int], bytes]:
    """Command without its size, index and subindex, and value."""
    command, index, subindex, value = SDO.unpack(data)
    if command & 0xF2 in (UPLOADED & 0xF2, DOWNLOAD & 0xF2):
        size = 4 - (command >> 2 & 3) if command & 1 else 4
        command, value = command & 0xF2 | 1, value[:size]
    return command, (index, subindex), value
