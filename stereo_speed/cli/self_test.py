# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``self-test``: measure a stored pass, detected automatically, and compare with its known speed.

Exit status: 0 within 1 %, 1 otherwise, 2 bad input.
"""
from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ..core.errors import InputError
from ..io.bags import StereoBag
from ..io.truth import read_truth
from ..pipeline.config import load_pipeline_config
from ..pipeline.self_test import self_test
from ..site.file import load_site

FAILED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``self-test``."""
    parser.add_argument('folder', metavar='DIR', type=Path,
                        help='folder with bag/, site.yaml and truth.csv, as written by simulate')
    parser.add_argument('--config', type=Path, metavar='YAML', help='parameters')
    parser.add_argument('--tracker', default='constrained', metavar='NAME')
    parser.add_argument('--detector', default='plane_sweep', metavar='NAME')


def run(args: argparse.Namespace) -> int:
    """Measure the stored pass, and print one line."""
    config = load_pipeline_config(args.config, tracker=args.tracker, detector=args.detector)
    truths = read_truth(args.folder / 'truth.csv')
    if len(truths) != 1:
        raise InputError(args.folder / 'truth.csv', 'vehicles', len(truths), 'one')
    site = load_site(args.folder / 'site.yaml')
    with StereoBag(args.folder / 'bag') as bag:
        done = self_test(site, bag.rig, bag.pairs, float(np.mean(truths[0].speed_mps)), config)
    print(done.line)
    return 0 if done.passed else FAILED
