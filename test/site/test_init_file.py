# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reading of init files: valid content, and refusals by name."""
from __future__ import annotations


import numpy as np
import pytest
from stereo_speed.core.errors import SiteError
from stereo_speed.site.init_file import load_init

NAN = float('nan')
QUAD = [[10, 10], [50, 11], [51, 40], [9, 39]]
INIT = {'stereo_speed_init': 1, 'vehicles': [
    {'frame': 0, 'left_image': QUAD, 'right_image': QUAD}]}


def test_init_is_read(write):
    """Annotated fronts arrive as arrays."""
    fronts = load_init(write(INIT))
    assert len(fronts) == 1 and fronts[0].frame == 0
    np.testing.assert_allclose(fronts[0].left_px, QUAD)


@pytest.mark.parametrize('place, value, match', [
    (['stereo_speed_init'], 0, 'stereo_speed_init: found 0'),
    (['vehicle'], [], 'vehicle: found unknown key'),
    (['vehicles'], [], 'vehicles: found an empty list'),
    (['vehicles', 0, 'frame'], -1, r'vehicles\[0\].frame: found -1'),
    (['vehicles', 0, 'frame'], 0.5, r'vehicles\[0\].frame: found 0.5'),
    (['vehicles', 0, 'frame'], True, r'vehicles\[0\].frame: found True'),
    (['vehicles', 0, 'id'], 3, r'vehicles\[0\].id: found unknown key id'),
    (['vehicles', 0, 'left_image'], QUAD + QUAD[:1], r'left_image: found 5 points, wanted 4'),
    (['vehicles', 0, 'left_image'], QUAD[:3], r'left_image: found 3 points, wanted at least 4'),
    (['vehicles', 0, 'left_image', 2, 1], NAN, r'left_image\[2\]: found nan'),
    (['vehicles', 0, 'right_image'], QUAD[::-1], 'right_image: found .*wanted corners clockwise'),
    (['vehicles', 0, 'right_image'], QUAD[1:] + QUAD[:1], 'clockwise from the image.s top-left'),
    (['vehicles', 0, 'right_image'], [QUAD[i] for i in (0, 2, 1, 3)], 'corners clockwise'),
])
def test_init_faults(write, place, value, match, put):
    """Each fault names its place."""
    with pytest.raises(SiteError, match=match):
        load_init(write(put(INIT, place, value)))
