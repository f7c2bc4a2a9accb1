# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The speed in a track message, for nodes that need not load the measuring code."""
from __future__ import annotations

from typing import Optional

from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry

# Variance of unmeasured quantities, in their units: large enough not to mislead a filter that uses
# it, and not to be taken for a measurement.
UNKNOWN = 1e6


def speed_of(track: Odometry) -> Optional[TwistWithCovarianceStamped]:
    """Return the speed of a track as published on ``vehicle_speed``; None if not measured."""
    if not 0 <= track.twist.covariance[0] < UNKNOWN:
        return None
    msg = TwistWithCovarianceStamped(twist=track.twist)
    msg.header.stamp, msg.header.frame_id = track.header.stamp, track.child_frame_id
    return msg
