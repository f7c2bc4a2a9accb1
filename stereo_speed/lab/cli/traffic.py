# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``traffic``: measure simulated traffic with automatic detection, and tabulate the score."""
from __future__ import annotations

import argparse
from pathlib import Path

from ..evaluation.labeled_sequence import LineKnowledge
from ..evaluation.lane_changes import change_job, change_jobs, changes_table
from ..evaluation.producer import produced
from ..evaluation.traffic import traffic_table
from ..evaluation.traffic_run import measure_traffic, stream_of, traffic_site, write_traffic
from ..sim.config import RIGS
from ..sim.traffic_config import LIGHTS, traffic_config
from ...batch.job import failures
from ...batch.runner import run_jobs
from ...cli.options import number_in, report_failures
from ...core.errors import InputError
from ...core.tracker_config import TrackerConfig
from ...io.atomic import prepare_folder
from ...pipeline.config import PipelineConfig, SiteConfig
from ...steadying.config import SteadyingConfig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``traffic``."""
    add = parser.add_argument
    add('--minutes', type=number_in(float, 0.05, 600), default=10.0, help='length of the stream')
    add('--vehicles', type=number_in(int, 1, 5000), default=200, help='number of vehicles')
    add('--fps', type=number_in(float, 0.5, 60), default=10.0, help='pairs per second')
    add('--lanes', type=int, choices=(1, 2, 3), default=3)
    add('--receding', type=int, choices=(0, 1, 2), default=0,
        help='number of lanes, from the left, whose vehicles drive away and show their rears')
    add('--light', choices=sorted(LIGHTS), default='day')
    add('--outdoors', action='store_true',
        help='bodies with depth, including motorcycles, buses and small cars')
    add('--rig', choices=sorted(RIGS), default='parallel')
    add('--sway-deg', type=number_in(float, 0, 1), default=0.0, metavar='DEG',
        help='sway of the rig: 1-sigma of each of its angles, independent in each pair')
    add('--turn-deg', type=number_in(float, -1, 1), default=0.0, metavar='DEG',
        help='angle by which the right camera pans to the right in the middle of the stream')
    add('--seed', type=number_in(int, 0, 2 ** 63), default=0)
    add('--particles', type=int, default=TrackerConfig().particles)
    add('--jobs', type=int, choices=(1, 2), default=2,
        help='2 to render in a process of its own (default)')
    where = parser.add_mutually_exclusive_group()
    where.add_argument('--out', type=Path, metavar='DIR',
                       help='write tracks.csv, passes.csv, summary.json and truth.csv there')
    where.add_argument('--bag', type=Path, metavar='DIR',
                       help='only write the stream as a bag, with site and truth')
    add('--raw', action='store_true',
        help='with --bag: write mono8 images, four times as large as the default PNG')
    where.add_argument('--lane-changes', type=number_in(int, 1, 1000), metavar='SEEDS',
                       help='instead of a stream, measure each lane change of the 2012 paper '
                            'with this many seeds, also with a tracker that keeps to the path')
    add('--lines', choices=[k.value for k in LineKnowledge], default='refined',
        help='how the lines of the road are known: as clicked, clicked and refined by the images '
             '(default), or exactly')


def run(args: argparse.Namespace) -> int:
    """
    Simulate, measure, print the table, and write the files.

    :raises InputError: parameters that do not fit together, or a folder that cannot be written.
    """
    steadying = SteadyingConfig(enabled=args.sway_deg > 0 or args.turn_deg != 0)
    parameters = PipelineConfig(TrackerConfig(particles=args.particles),
                                site=SiteConfig(steadying=steadying))
    if args.raw and args.bag is None:
        raise InputError('traffic', '--raw', 'no --bag', 'a bag to write')
    if args.lane_changes is not None:
        return _tabulate_changes(args)
    if args.receding >= args.lanes and args.receding:
        raise InputError('traffic', '--receding', args.receding, f'fewer than {args.lanes}')
    config = traffic_config(
        args.light, args.lanes, args.receding, args.fps, args.minutes, args.vehicles,
        outdoors=args.outdoors, rig=RIGS[args.rig], sway_deg=args.sway_deg,
        right_turn_deg=(args.turn_deg, 0.0, 0.0),
        right_turn_s=30.0 * args.minutes if args.turn_deg else None)
    if args.bag is not None:
        # Only writing bags needs rosbags.
        from ..sim.write import write_traffic_bag
        print(write_traffic_bag(stream_of(config, args.seed), args.bag,
                                compressed=not args.raw))
        return 0
    if args.out is not None:
        prepare_folder(args.out)
    site = traffic_site(config, args.seed, LineKnowledge(args.lines))
    stream = (stream_of(config, args.seed) if args.jobs == 1
              else produced(stream_of, config, args.seed))
    result = measure_traffic(stream, site.pipeline(parameters, None, seed=args.seed),
                             round(args.minutes * 60 * args.fps))
    score = result.score()
    if args.out is not None:
        write_traffic(args.out, result, score, {
            **parameters.summary(), 'seed': args.seed, 'traffic': {k: getattr(args, k) for k in (
                'minutes', 'vehicles', 'fps', 'lanes', 'receding', 'light', 'outdoors', 'rig',
                'lines', 'sway_deg', 'turn_deg')}})
    receding = f', {args.receding} receding' if args.receding else ''
    name = (f'{args.minutes:g} min, {args.fps:g} fps, {args.lanes} lanes{receding}, '
            f'{args.light}' + (', outdoors' if args.outdoors else ''))
    print(traffic_table(name, score, result.pair_ms).markdown(), end='')
    return 0


def _tabulate_changes(args: argparse.Namespace) -> int:
    """Measure the paper's lane changes and print their table."""
    jobs = change_jobs(range(args.seed, args.seed + args.lane_changes), args.particles,
                       LineKnowledge(args.lines))
    results = run_jobs(jobs, change_job, out_dir=None, workers=args.jobs,
                       description='lane changes')
    print(changes_table(jobs, results).markdown(), end='')
    return report_failures(failures(results))
