# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated passes for all baselines, and a way to run them."""
from __future__ import annotations

import cv2
import numpy as np
import pytest
from stereo_speed.core.config import TrackerConfig
from stereo_speed.lab.sim.config import DISTORTED, straight_config
from stereo_speed.lab.sim.sequence import simulate
from stereo_speed.pipeline.assembly import make_pipeline
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.pipeline.run import run as run_pipeline
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
from stereo_speed.site.lane_paths import lane_paths
import yaml

cv2.setNumThreads(1)


@pytest.fixture(scope='session')
def straight():
    """45 mph, distorted and converging cameras, uneven stamps and a pair lost on the way."""
    config = straight_config('45 mph', rig=DISTORTED, start_m=50.0, stamp_jitter_s=0.02, drop=(5,))
    return simulate(config, np.random.default_rng(1))


@pytest.fixture(scope='session')
def drive(tmp_path_factory):
    """Run a tracker over a sequence: updates and the one pass; whole passes run only once."""
    known = {}

    def run(sequence, tracker, pairs=None, **changes):
        folder = tmp_path_factory.mktemp('site')
        site, init = folder / 'site.yaml', folder / 'init.yaml'
        site.write_text(yaml.safe_dump(dict(sequence.site_exact)))
        init.write_text(yaml.safe_dump(dict(sequence.init)))
        done = run_pipeline(make_pipeline(
            sequence.rig, lane_paths(load_site(site), sequence.rig),
            PipelineConfig(TrackerConfig(**changes), tracker), load_init(init)), pairs or sequence.pairs)
        return done.updates, *done.passes

    def once(sequence, tracker, pairs=None, **changes):
        if pairs is not None:
            return run(sequence, tracker, pairs, **changes)
        key = id(sequence), tracker
        if key not in known:
            known[key] = run(sequence, tracker)
        return known[key]
    return once
