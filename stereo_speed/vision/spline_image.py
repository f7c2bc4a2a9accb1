# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Interpolation of images by a cubic spline."""
from __future__ import annotations

from typing import Any, Union

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from ..core.records import Array

_NOWHERE_PX = -1e6  # stands for NaN, as it is outside any image


class SplineImage:
    """
    An image that can be interpolated between its pixels.

    :param image: (H, W) grey levels.
    :param dtype: type of the spline's coefficients; single precision is good to 1e-5 grey levels.
    """

    def __init__(self, image: NDArray[Any],
                 dtype: Union[type[np.float32], type[np.float64]] = np.float32) -> None:
        self.shape = image.shape
        self._coefficients: NDArray[np.floating[Any]] = np.asarray(
            spline_filter(image.astype(dtype), order=3, output=dtype))

    def __call__(self, uv_px: Array) -> Array:
        """Return the grey levels (...,) at pixels (..., 2); NaN outside the image."""
        uv = np.nan_to_num(uv_px, nan=_NOWHERE_PX)
        values = map_coordinates(self._coefficients, [uv[..., 1], uv[..., 0]], order=3,
                                 prefilter=False, mode='nearest', output=np.float64)
        height, width = self.shape
        inside = ((uv >= 0) & (uv <= [width - 1, height - 1])).all(axis=-1)
        return np.where(inside, values, np.nan)
