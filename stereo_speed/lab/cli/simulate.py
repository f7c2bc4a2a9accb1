# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``simulate``: write a simulated pass as a bag with its site, initial fronts and truth."""
from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..sim import (
    circle_config, RIGS, RoadConfig, SimConfig, simulate, straight_config, VehicleConfig)
from ..sim.bodies import BODIES
from ..sim.optics import FaultConfig, LensConfig
from ..sim.ride import ROUGHNESS_M3, with_ride
from ..sim.traffic_config import LIGHTS
from ...cli.options import number_in
from ...core.errors import InputError
from ...core.units import MPH_MPS, parse_speed

STORAGES = ('mcap', 'sqlite3', 'ros1')  # as in sim.write, which needs rosbags


def _speed(text: str) -> float:
    try:
        return parse_speed(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _limit(text: str) -> str:
    _speed(text)
    return text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``simulate``."""
    add = parser.add_argument
    add('--out', type=Path, required=True, help='folder to write; must not exist')
    add('--speed', type=_speed, default=_speed('55 mph'),
        help="'55 mph', '80 km/h' or '22 m/s' (default: '55 mph')")
    add('--accel', type=number_in(float, -12, 12), default=0.0, help='acceleration, m/s^2')
    add('--path', default='straight',
        help='straight, circle:RADIUS_M or clothoid:CURVATURE:CURVATURE:LENGTH_M (1/m; positive '
             'turns left)')
    add('--grade', type=number_in(float, -0.2, 0.2), default=0.0, help='rise over distance')
    add('--lanes', type=int, choices=(1, 2, 3), default=2)
    add('--lane', type=int, default=0, help='lane of the vehicle, 0 the rightmost')
    add('--lane-change', type=number_in(float, -8, 8), default=0.0, metavar='M',
        help='move this far to the left between 0.6 s and 2.8 s')
    add('--start', type=number_in(float, 5, 200), help='distance of the first front, m')
    add('--near', type=number_in(float, 4, 100), help='distance at which the pass ends, m')
    add('--pairs', type=number_in(int, 1, 2000), help='greatest number of pairs')
    add('--fps', type=number_in(float, 0.1, 200), default=5.0)
    add('--jitter', type=number_in(float, 0, 1), default=0.0, help='unevenness of the stamps, s')
    add('--drop', type=int, nargs='*', default=[], metavar='PAIR',
        help='numbers of pairs that are lost')
    add('--noise', type=number_in(float, 0, 50), default=2.0, help='sensor noise, grey levels')
    add('--exposure', type=number_in(float, 0.05, 2), default=1.0,
        help='brightness: 1 day, 0.35 dusk')
    add('--rig', choices=sorted(RIGS), default='parallel')
    add('--rig-moved', type=number_in(float, -10, 10), nargs=3, default=(0.0, 0.0, 0.0),
        metavar=('PAN', 'TILT', 'ROLL'),
        help='degrees by which the right camera has turned since its calibration')
    add('--gap', type=number_in(float, 0, 1000), nargs=2, metavar=('FROM', 'TO'),
        help='time, s, in which no pair arrives')
    add('--camera-height', type=number_in(float, 0.5, 30), default=4.0,
        help='height of the cameras above the road, m')
    add('--front-height', type=number_in(float, 0.3, 3),
        help='height of the front, m (default: 0.8, or that of --kind)')
    add('--kind', choices=sorted(filter(None, BODIES)),
        help='body with a front that is not flat (default: a car with a painted flat front)')
    add('--lamp-grey', type=number_in(float, 0, 1e6), default=0.0,
        help='grey level of the lit lamps of --kind; 255 is full scale')
    add('--gloss', type=number_in(float, 0, 1), default=0.0,
        help='gloss of the paint of --kind; 1 is lacquer')
    add('--ride', choices=sorted(ROUGHNESS_M3),
        help='class of the road (ISO 8608) over which the vehicle moves on its springs; '
             'motorcycles lean into bends (default: level with the road)')
    add('--light', choices=sorted(LIGHTS), help='light of the scene (default: an even sky)')
    add('--lens', type=number_in(float, 0, 50), nargs=3, metavar=('CORE_PX', 'SHARE', 'HALO_PX'),
        default=(0.0, 0.0, 8.0), help='point spread: core, and share and width of its halo')
    add('--exposure-step', type=number_in(float, 0, 0.9), default=0.0,
        help='largest random change of the exposure of a pair, as a share')
    add('--right-gain', type=number_in(float, 0.1, 10), default=1.0,
        help='gain of the right camera')
    add('--right-defocus', type=number_in(float, 0, 20), default=0.0, metavar='PX',
        help='1-sigma of the blur of the right camera')
    add('--dirt', type=number_in(int, 0, 200), default=0,
        help='number of specks on the right camera')
    add('--speed-limit', type=_limit, default='45 mph',
        help='speed limit in the site file, such as 45 mph')
    add('--seed', type=number_in(int, 0, 2 ** 63), default=0)
    add('--storage', choices=STORAGES, default='mcap')
    add('--encoding', default='mono8', help='encoding of raw images: mono8, bgr8, …')
    add('--compressed', action='store_true', help='write JPEG messages instead of raw ones')


def _pass(text: str) -> SimConfig:
    """Return the pass for ``--path``, with its usual distances."""
    kind, *numbers = text.split(':')
    try:
        values = [float(number) for number in numbers]
    except ValueError:
        values = []
    if kind == 'straight' and not numbers:
        return straight_config()
    if kind == 'circle' and len(values) == 1 and 5 <= abs(values[0]) < 1e6:
        return circle_config(radius_m=values[0])
    if kind == 'clothoid' and len(values) == 3 and max(map(abs, values[:2])) <= 0.2 \
            and 1 <= values[2] <= 1000:
        road = RoadConfig(
            curvature_start=values[0], curvature_end=values[1], clothoid_m=values[2])
        return circle_config(road=road)
    raise InputError('simulate', '--path', text,
                     'straight, circle:RADIUS_M or clothoid:CURVATURE:CURVATURE:LENGTH_M')


def _front(args: argparse.Namespace) -> VehicleConfig:
    """
    Return a vehicle with its appearance, but not its motion.

    :raises InputError: lamps or gloss are given for a painted front.
    """
    if args.kind is None:
        for name in ('lamp_grey', 'gloss'):
            if getattr(args, name):
                raise InputError('simulate', '--' + name.replace('_', '-'), getattr(args, name),
                                 'a --kind beside it')
        return VehicleConfig(front_height_m=args.front_height or VehicleConfig.front_height_m)
    body = BODIES[args.kind]
    return VehicleConfig(
        kind=args.kind, solid=True, front_width_m=body.width_m, clearance_m=body.clearance_m,
        front_height_m=args.front_height or body.front_m, lamp_grey=args.lamp_grey,
        gloss=args.gloss)


def make_config(args: argparse.Namespace) -> SimConfig:
    """
    Return the configuration of the simulation from parsed arguments.

    :raises InputError: an argument that cannot be simulated.
    """
    config = _pass(args.path)
    change = ((0.6, 0.0), (2.8, args.lane_change)) if args.lane_change else ()
    vehicle = replace(_front(args), speed_mps=args.speed, accel_mps2=args.accel, lane=args.lane,
                      lateral_knots=change)
    config = replace(
        config, vehicles=(vehicle,), rig=RIGS[args.rig],
        road=replace(config.road, grade=args.grade, lanes=args.lanes),
        start_m=args.start or config.start_m, near_m=args.near or config.near_m,
        pairs=args.pairs, fps=args.fps, stamp_jitter_s=args.jitter, drop=tuple(args.drop),
        noise_grey=args.noise, exposure=args.exposure, camera_height_m=args.camera_height,
        speed_limit=args.speed_limit, name=args.out.name, rig_moved_deg=tuple(args.rig_moved),
        gaps_s=(tuple(args.gap),) if args.gap else (), right_gain=args.right_gain,
        light=LIGHTS[args.light][0] if args.light else None, lens=LensConfig(
            core_px=args.lens[0], halo_share=args.lens[1], halo_px=args.lens[2]),
        faults=FaultConfig(exposure_step=args.exposure_step, dirt=args.dirt,
                           right_defocus_px=args.right_defocus))
    return with_ride(config, args.ride, args.seed) if args.ride else config


def run(args: argparse.Namespace) -> int:
    """
    Simulate and write.

    :param args: parsed arguments.
    :return: exit status.
    :raises InputError: an argument that cannot be simulated, or a folder that is not empty.
    """
    # Only writing needs rosbags.
    from ..sim.write import write_bag

    sequence = simulate(make_config(args), np.random.default_rng(args.seed))
    folder = write_bag(sequence, args.out, args.storage, args.encoding, args.compressed)
    print(f'{folder}: {len(sequence.pairs)} pairs, {args.path}, '
          f'{args.speed / MPH_MPS:.1f} mph ({args.speed * 3.6:.1f} km/h)')
    return 0
