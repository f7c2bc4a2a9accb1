# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Points and frames of a reference line, integrated along its angles; for ``RoadModel``."""
from __future__ import annotations

from typing import Any

import numpy as np

from ..core.compiled import kernel
from ..core.records import Array


def _plain(psi: Array, theta: Array, phi: Array, axes: Array, origin_m: Array, step_m: float
           ) -> tuple[Array, Array]:
    """
    Return the points (k, n, 3) and frames (k, n, 3, 3) at the nodes of ``k`` lines.

    Simpson's rule integrates the direction from node to node.

    :param psi: (k, 2 n - 1) headings at nodes and midpoints, rad; grades ``theta`` and crossfalls
        ``phi`` alike.
    :param axes: (k, 3, 3) frame to which the angles refer.
    :param origin_m: (k, 3) point in the middle, m.
    :param step_m: arc length between nodes, m.
    """
    cp, sp, ct, st = np.cos(psi), np.sin(psi), np.cos(theta), np.sin(theta)
    cf, sf = np.cos(phi), np.sin(phi)
    tangent = np.stack([cp * ct, sp * ct, st], axis=-1)
    left = np.stack([-sp * cf - cp * st * sf, cp * cf - sp * st * sf, ct * sf], axis=-1)
    simpson = step_m / 6 * (tangent[:, :-2:2] + 4 * tangent[:, 1::2] + tangent[:, 2::2])
    way = np.concatenate([np.zeros_like(tangent[:, :1]), np.cumsum(simpson, axis=1)], axis=1)
    middle = way.shape[1] // 2
    way = way - way[:, middle:middle + 1]
    tangent, left = tangent[:, ::2], left[:, ::2]
    local = np.stack([tangent, left, np.cross(tangent, left)], axis=-1)
    points = origin_m[:, None] + way @ np.swapaxes(axes, -1, -2)
    return points, axes[:, None] @ local


@kernel(_plain, '(f8[:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8)')
def along(psi: Any, theta: Any, phi: Any, axes: Any, origin_m: Any, step_m: float) -> Any:
    """Return what :func:`_plain` returns."""
    count, nodes = len(psi), (psi.shape[1] + 1) // 2
    points, frames = np.empty((count, nodes, 3)), np.empty((count, nodes, 3, 3))
    tangent, left, up = np.empty((2 * nodes - 1, 3)), np.empty(3), np.empty(3)
    way = np.zeros((nodes, 3))
    for k in range(count):
        for i in range(2 * nodes - 1):
            cp, sp = np.cos(psi[k, i]), np.sin(psi[k, i])
            ct, st = np.cos(theta[k, i]), np.sin(theta[k, i])
            x, y, z = cp * ct, sp * ct, st
            tangent[i, 0], tangent[i, 1], tangent[i, 2] = x, y, z
            if i % 2:
                continue
            cf, sf = np.cos(phi[k, i]), np.sin(phi[k, i])
            left[0], left[1], left[2] = -sp * cf - cp * st * sf, cp * cf - sp * st * sf, ct * sf
            up[0], up[1] = y * left[2] - z * left[1], z * left[0] - x * left[2]
            up[2] = x * left[1] - y * left[0]
            for a in range(3):
                p, q, r = axes[k, a, 0], axes[k, a, 1], axes[k, a, 2]
                frames[k, i // 2, a, 0] = p * x + q * y + r * z
                frames[k, i // 2, a, 1] = p * left[0] + q * left[1] + r * left[2]
                frames[k, i // 2, a, 2] = p * up[0] + q * up[1] + r * up[2]
        for n in range(1, nodes):
            for d in range(3):
                way[n, d] = way[n - 1, d] + step_m / 6 * (
                    tangent[2 * n - 2, d] + 4 * tangent[2 * n - 1, d] + tangent[2 * n, d])
        for n in range(nodes):
            x, y, z = (way[n, 0] - way[nodes // 2, 0], way[n, 1] - way[nodes // 2, 1],
                       way[n, 2] - way[nodes // 2, 2])
            for a in range(3):
                points[k, n, a] = (origin_m[k, a] + axes[k, a, 0] * x + axes[k, a, 1] * y
                                   + axes[k, a, 2] * z)
    return points, frames
