"""Messages as bytes together with their publisher, which rcl provides and rclpy does not pass on.

rclpy 7.1 gives a callback a message's send time and sequence number, but not its publisher. Without the publisher, two
simulators of the same scene, which give their runs the same id, cannot be distinguished. So messages are taken here by
the function that rclpy's Subscription.take_message calls, rcl_take_serialized_message (rcl/subscription.h).
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import NamedTuple

from rclpy.subscription import Subscription

_TAKEN, _NOTHING_TO_TAKE = 0, 401  # RCL_RET_OK, RCL_RET_SUBSCRIPTION_TAKE_FAILED (rcl/types.h)

# An RTPS GUID begins with its participant's 12 bytes (DDSI-RTPS 2.2, 8.2.4.1): all publishers of a process share them.
_PARTICIPANT_BYTES = 12


class Origin(NamedTuple):
    """Where a message came from."""

    publisher: bytes  # its gid, as in Node.get_publishers_info_by_topic
    sequence_number: int  # of this publisher's messages on this topic: 1, 2, 3 ...

    @property
    def participant(self) -> bytes:
        """The participant that the publisher belongs to."""
        return participant_of(self.publisher)


def participant_of(publisher: bytes) -> bytes:
    """Common to all publishers of one process (strictly: of one rclpy context)."""
    return publisher[:_PARTICIPANT_BYTES]


def take_with_origin(subscription: Subscription) -> tuple[bytes, Origin] | None:
    """The next message of `subscription`, serialized; None where there is none."""
    rcl, allocator = _library()
    message = _SerializedMessage(allocator=allocator)
    info = _MessageInfo()
    handle = subscription.handle
    with handle:
        status = rcl.rcl_take_serialized_message(handle.pointer, ctypes.byref(message), ctypes.byref(info), None)
    try:
        if status == _NOTHING_TO_TAKE:
            return None
        if status != _TAKEN:
            rcl.rcutils_reset_error()
            raise RuntimeError(f"{subscription.topic}: a message cannot be taken, status {status} of rcl")
        data = ctypes.string_at(message.buffer, message.buffer_length)
        return data, Origin(bytes(info.publisher_gid.data), info.publication_sequence_number)
    finally:
        rcl.rcutils_uint8_array_fini(ctypes.byref(message))


class _Allocator(ctypes.Structure):  # rcutils_allocator_t
    _fields_ = [
        (name, ctypes.c_void_p) for name in ("allocate", "deallocate", "reallocate", "zero_allocate", "state")
    ]


class _SerializedMessage(ctypes.Structure):  # rcutils_uint8_array_t
    _fields_ = [
        ("buffer", ctypes.c_void_p),
        ("buffer_length", ctypes.c_size_t),
        ("buffer_capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


class _Gid(ctypes.Structure):  # rmw_gid_t
    _fields_ = [("implementation_identifier", ctypes.c_char_p), ("data", ctypes.c_uint8 * 16)]


class _MessageInfo(ctypes.Structure):  # rmw_message_info_t
    _fields_ = [
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("reception_sequence_number", ctypes.c_uint64),
        ("publisher_gid", _Gid),
        ("from_intra_process", ctypes.c_bool),
    ]


@cache
def _library() -> tuple[ctypes.CDLL, _Allocator]:
    """The rcl library that rclpy has already loaded (it includes rcutils), and its allocator."""
    rcl = ctypes.CDLL("librcl.so")
    rcl.rcl_take_serialized_message.argtypes = [ctypes.c_void_p] * 4
    rcl.rcl_take_serialized_message.restype = ctypes.c_int32
    rcl.rcutils_uint8_array_fini.argtypes = [ctypes.c_void_p]
    rcl.rcutils_get_default_allocator.restype = _Allocator
    return rcl, rcl.rcutils_get_default_allocator()
