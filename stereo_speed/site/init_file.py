# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reading of init files: the annotated fronts of vehicles."""
from __future__ import annotations

from pathlib import Path as FilePath
from typing import Union

from .file import VIEWS
from ..core.records import InitialFront
from ..core.strict_yaml import load_yaml, StrictMapping


def load_init(path: Union[str, FilePath]) -> tuple[InitialFront, ...]:
    """
    Return the annotated fronts of an init file.

    :raises SiteError: names the first fault.
    """
    data = load_yaml(path, 'stereo_speed_init')
    top = StrictMapping(path, '', data, ('stereo_speed_init', 'vehicles'))
    fronts = []
    for i, vehicle in enumerate(top.listed('vehicles')):
        fields = StrictMapping(path, f'vehicles[{i}]', vehicle, ('frame', *VIEWS))
        left, right = (fields.quad(view) for view in VIEWS)
        fronts.append(InitialFront(fields.integer('frame'), left, right))
    return tuple(fronts)
