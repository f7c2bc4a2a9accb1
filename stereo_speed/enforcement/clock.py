# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""State of the system's clock: whether it is synchronized, and its maximum error."""
from __future__ import annotations

import ctypes
import ctypes.util
from typing import Any, Optional

_TIME_ERROR = 5  # state of an unsynchronized clock, adjtimex(2)
_NANO = 0x2000  # status bit: offsets are ns, not us
_UNSYNC = 0x0040  # status bit


class _Timex(ctypes.Structure):
    """``struct timex`` of Linux, <sys/timex.h>."""

    _fields_ = [
        ('modes', ctypes.c_uint), ('offset', ctypes.c_long), ('freq', ctypes.c_long),
        ('maxerror', ctypes.c_long), ('esterror', ctypes.c_long), ('status', ctypes.c_int),
        ('rest', ctypes.c_char * 512)]


def clock_state() -> Optional[dict[str, Any]]:
    """
    Return the state of the system's clock from ``adjtimex(2)``.

    :return: whether it is ``synchronized``, the ``offset_s`` that is being corrected, and the
        kernel's ``max_error_s``; None where ``adjtimex`` is not available.
    """
    try:
        adjtimex = ctypes.CDLL(ctypes.util.find_library('c') or 'libc.so.6').adjtimex
    except (OSError, AttributeError):
        return None
    found = _Timex()  # modes 0: only read
    state = int(adjtimex(ctypes.byref(found)))
    if state < 0:
        return None
    unit_s = 1e-9 if found.status & _NANO else 1e-6
    return {'synchronized': state != _TIME_ERROR and not found.status & _UNSYNC,
            'offset_s': round(found.offset * unit_s, 9),
            'max_error_s': round(found.maxerror * 1e-6, 6), 'told_by': 'adjtimex'}
