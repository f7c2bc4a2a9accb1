# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Compile all kernels once, so that programs that start in parallel need not do so."""
from stereo_speed.core.compiled import warm_up
from stereo_speed.pipeline.config import load_pipeline_config
from stereo_speed.pipeline.registry import DETECTORS, TRACKERS

if __name__ == '__main__':
    config = load_pipeline_config(None)
    TRACKERS.load(config.tracker)
    DETECTORS.load(config.detector)
    print(f'kernels: {warm_up()}')
