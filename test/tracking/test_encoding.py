# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Fronts seen by cameras that write light, or a root of it."""
from __future__ import annotations

from dataclasses import replace

import pytest
from stereo_speed.core.tracker_config import NoiseConfig, TrackerConfig, VerdictConfig
from stereo_speed.tracking.constrained import ConstrainedTracker

BLUR_PX, TRUE_MPS = 1.0, 20.0
# Neither rows nor disparities tell the speed, only how the front grows.
BY_GROWTH = TrackerConfig(
    smooth_share=0.0, smooth_ride_std_m=0.3, rough_ride_std_m=0.3, onset_per_s=0.0,
    manoeuvre_probability=0.0, verdict=VerdictConfig(most_scatter_px=10.0))


@pytest.mark.parametrize('camera', [1.0, 2.2])
def test_speed_by_growth_has_no_bias_if_gamma_is_known(textured, camera):
    """A root that cameras take but the tracker does not know makes fronts grow too slowly."""
    errors = {1.0: 0.0, 2.2: 0.0}
    for seed in range(4):
        front = replace(textured, seed=seed)
        pairs, poses = front.drive(count=20, speed_mps=TRUE_MPS, pose=(2.0, 0.1, 1.9))
        pairs = [front.softened(front.with_contrast(pair), BLUR_PX, camera) for pair in pairs]
        for gamma in errors:
            config = replace(BY_GROWTH, noise=NoiseConfig(gamma=gamma, match_floor_px=1.0))
            tracker = ConstrainedTracker.start(
                front.start(pairs[0], poses[0], config), ConstrainedTracker.Settings())
            for pair in pairs:
                tracker.update(pair)
            errors[gamma] += (tracker.result().speed_mps / TRUE_MPS - 1) / 4
    assert abs(errors[camera]) < 3e-4
    assert errors[2.2] - errors[1.0] > 3e-4
