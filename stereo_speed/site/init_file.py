# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reading of init files: the fronts of vehicles as a person annotated them."""
from __future__ import annotations

from pathlib import Path as FilePath
from typing import Union

import numpy as np

from .file import VIEWS
from ..core.records import Array, InitialFront
from ..core.strict_yaml import load_yaml, StrictMapping


def load_init(path: Union[str, FilePath]) -> tuple[InitialFront, ...]:
    """
    Read an init file.

    :raises SiteError: names the first fault.
    """
    top = StrictMapping(path, '', load_yaml(path, 'stereo_speed_init'), ('stereo_speed_init', 'vehicles'))
    marks = []
    for i, data in enumerate(top.listed('vehicles')):
        fields = StrictMapping(path, f'vehicles[{i}]', data, ('frame', *VIEWS))
        quads = []
        for view in VIEWS:
            quad = fields.points(view, 2, 4)
            if len(quad) != 4:
                raise fields.error(view, f'{len(quad)} corners', '4')
            if not _clockwise(quad):
                raise fields.error(view, quad.tolist(),
                                   "corners clockwise from the image's top-left corner")
            quads.append(quad)
        marks.append(InitialFront(fields.integer('frame'), *quads))
    return tuple(marks)


def _clockwise(quad: Array) -> bool:
    """Say whether corners (4, 2) are convex and clockwise, y down, from the top left."""
    side = np.roll(quad, -1, axis=0) - quad
    after = np.roll(side, -1, axis=0)
    turns = side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0]
    return bool((turns > 0).all() and side[0, 0] > 0 and side[3, 1] < 0)
