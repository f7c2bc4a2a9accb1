# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Compile modules and kernels once, so that programs that start in parallel need not do so."""
from compileall import compile_dir
from pathlib import Path

from stereo_speed.core import compiled
from stereo_speed.pipeline.config import load_pipeline_config
from stereo_speed.pipeline.registry import DETECTORS, TRACKERS

if __name__ == '__main__':
    # also where PYTHONDONTWRITEBYTECODE would make each process compile what it imports
    compile_dir(Path(compiled.__file__).parents[1], quiet=1)
    config = load_pipeline_config(None)
    TRACKERS.load(config.tracker)
    DETECTORS.load(config.detector)
    print(f'kernels: {compiled.warm_up()}')
