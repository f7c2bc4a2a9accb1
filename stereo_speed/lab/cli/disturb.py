# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``disturb``: copy a bag as if the rig had swayed, or a camera were displaced or out of focus.

Or as if its calibration were further off.  It shows what would be measured of the same traffic
from a pole in the wind.  DIR/bag is measured with the same site.  Cameras are rotated about their
own centres, which is exact except at the border: new regions repeat the edge, over about f
tan(angle), which is 3 px for 0.1 degrees at f = 1800 px.
"""
from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ..sim.disturb import Disturbance
from ...cli.options import number_in
from ...geometry.rig import angles_of, StereoRig

AXES = ('pan', 'tilt', 'roll')
CAMERAS = ('left', 'right')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``disturb``."""
    add = parser.add_argument
    add('bag', type=Path, help='rosbag2 folder, .mcap or .db3 file')
    add('--out', type=Path, required=True, metavar='DIR',
        help='folder to write; must not exist, or be empty')
    add('--left', metavar='TOPIC', help='left image topic (default: found by type and name)')
    add('--right', metavar='TOPIC', help='right image topic')
    add('--sway-deg', type=number_in(float, 0, 2), default=0.0, metavar='DEG',
        help='1-sigma of each angle of the rig')
    add('--sway-hz', type=number_in(float, 0, 1000), default=0.0, metavar='HZ',
        help='frequency of the sway, as of a mast (default: independent in each pair)')
    add('--turn-deg', type=number_in(float, -2, 2), default=0.0, metavar='DEG',
        help='angle by which one camera has turned')
    add('--turn-axis', choices=AXES, default='pan',
        help='axis of the turn, positive to the right, upwards or clockwise (default: pan)')
    add('--turn-at', type=number_in(float, 0, 1e6), default=0.0, metavar='S',
        help='time of the turn after the first pair, s (default: 0)')
    add('--exposure-step', type=number_in(float, 0, 0.9), default=0.0, metavar='SHARE',
        help='largest random change of the exposure of a pair')
    add('--defocus-px', type=number_in(float, 0, 20), default=0.0, metavar='PX',
        help='1-sigma of the blur of one camera')
    add('--gamma', type=number_in(float, 1, 4), default=1.0,
        help='blur the light of which the grey levels are this root, as lenses do: 2.2 for most '
        'cameras (default: 1, which blurs grey levels)')
    add('--camera', choices=CAMERAS, default='right',
        help='camera that turns or is out of focus (default: right)')
    add('--calibration', action='store_true',
        help='add errors to the calibration of focal length, baseline and angles between the '
        'cameras: normal ones with the default tolerances as 1-sigma')
    add('--seed', type=number_in(int, 0, 2 ** 63), default=0)


def run(args: argparse.Namespace) -> int:
    """
    Write a disturbed copy of a bag.

    :param args: parsed arguments.
    :return: exit status.
    :raises InputError: an unusable bag, no disturbance, or a folder that is not empty.
    """
    from ..sim.disturb_bag import disturb_bag

    pan, tilt, roll = (args.turn_deg if axis == args.turn_axis else 0.0 for axis in AXES)
    what = Disturbance(
        sway_deg=args.sway_deg, sway_hz=args.sway_hz, turn_deg=(pan, tilt, roll),
        turn_s=args.turn_at, exposure_step=args.exposure_step, defocus_px=args.defocus_px,
        gamma=args.gamma, camera=CAMERAS.index(args.camera), calibration=args.calibration)
    done = disturb_bag(args.bag, args.out, what, np.random.default_rng(args.seed), args.left,
                       args.right)
    print(f'{args.out}: {done.pairs} pairs')
    if args.calibration:
        print(_errors(done.rig, done.calibrated))
    return 0


def _errors(rig: StereoRig, calibrated: StereoRig) -> str:
    """Return what a calibration of a rig has got wrong, of the angles that of the right camera."""
    focal = calibrated.left.K[0, 0] / rig.left.K[0, 0] - 1
    baseline_mm = 1000 * (calibrated.baseline_m - rig.baseline_m)
    pan, tilt, roll = np.degrees(angles_of(calibrated.R @ rig.R.T))
    return (f'calibration: focal length {100 * focal:+.3f} %, baseline {baseline_mm:+.2f} mm, pan '
            f'{pan:+.4f}°, tilt {tilt:+.4f}°, roll {roll:+.4f}°')
