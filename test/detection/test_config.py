# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the detectors: combinations that could detect nothing are refused."""
from __future__ import annotations

import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.detection.box_detector import BoxConfig
from stereo_speed.detection.config import DetectorConfig, FrontConfig, MotionConfig


@pytest.mark.parametrize(('kind', 'values', 'named'), [
    (FrontConfig, {'low_m': 0.8, 'high_m': 0.8}, 'low_m: found 0.8, wanted less than high_m'),
    (FrontConfig, {'tall_low_m': 1.3}, 'tall_low_m: found 1.3, wanted less than tall_high_m'),
    (FrontConfig, {'raised_low_m': 1.1},
     'raised_low_m: found 1.1, wanted less than raised_high_m'),
    (FrontConfig, {'tall_width_m': 3.0}, 'tall_width_m'),
    (MotionConfig, {'reference_s': 0.8}, 'reference_s: found 0.8'),
    (MotionConfig, {'least_speed_mps': 12.0, 'greatest_speed_mps': 12.0}, 'least_speed_mps'),
    (DetectorConfig, {'interval_s': 2.0, 'forget_after_s': 1.0}, 'interval_s: found 2.0'),
    (DetectorConfig, {'least_symmetry': 1.5}, 'least_symmetry'),
    (BoxConfig, {'forget_after_s': 0.15}, r'motion.reference_s: found 0.19'),
], ids=lambda value: str(value)[:30])
def test_config_that_cannot_find_anything_is_refused(kind, values, named):
    with pytest.raises(InputError, match=named):
        kind(**values)
