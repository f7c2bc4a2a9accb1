# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The speed of a track's message; who wants no more need not load what measures."""
from __future__ import annotations

from typing import Optional

from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry

# Variance of what is not measured, in the units of its quantity: so great that a filter which
# takes it at its word is not misled, and nobody takes it for a measurement.
UNKNOWN = 1e6


def speed_of(track: Odometry) -> Optional[TwistWithCovarianceStamped]:
    """Return the speed of a track as ``vehicle_speed`` has it; None without a measurement."""
    if not 0 <= track.twist.covariance[0] < UNKNOWN:
        return None
    msg = TwistWithCovarianceStamped(twist=track.twist)
    msg.header.stamp, msg.header.frame_id = track.header.stamp, track.child_frame_id
    return msg
