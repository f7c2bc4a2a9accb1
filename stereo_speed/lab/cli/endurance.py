# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``endurance``: time and memory of many bags, of long ones and of long live runs."""
from __future__ import annotations

import argparse
import json
from pathlib import Path
import shutil

from .soak import add_soak
from ..evaluation.endurance import cost_of, count_passes, long_table, many_table
from ..sim.repeat import repeat_bag
from ...cli.options import number_in
from ...io.atomic import prepare_folder
from ...io.results import SUMMARY

_SAMPLE = Path(__file__).resolve().parents[3] / 'sample' / 'straight55'
_GAP_S = 8.0  # time from one vehicle to the next
_TINY = 4  # number of pairs of a tiny bag


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``endurance``."""
    actions = parser.add_subparsers(metavar='ACTION', required=True)
    long = actions.add_parser('long', help='replay bags of increasing length')
    long.add_argument('--passes', type=number_in(int, 1, 100_000), nargs='+', default=[10, 100],
                      metavar='N', help='rounds of the sample in each bag (default: 10 100)')
    long.add_argument('--gap-s', type=number_in(float, 0.01, 86400), default=_GAP_S, metavar='S',
                      help=f'pause between rounds, s (default: {_GAP_S:g})')
    long.set_defaults(run=run_long)
    many = actions.add_parser('many', help='run replay-many over increasing numbers of bags')
    many.add_argument('--bags', type=number_in(int, 1, 100_000), nargs='+', default=[10, 100],
                      metavar='N', help='number of bags of each run (default: 10 100)')
    many.add_argument('--jobs', type=number_in(int, 0, 512), default=2, metavar='N')
    many.set_defaults(run=run_many)
    for action in (long, many):
        action.add_argument('--sample', type=Path, default=_SAMPLE,
                            help='folder with bag/ and site.yaml; init.yaml too for many')
        action.add_argument('--out', type=Path, required=True, metavar='DIR')
    add_soak(actions)


def run_long(args: argparse.Namespace) -> int:
    """Replay the repeated sample with automatic detection, and print the table."""
    rows = []
    folder = prepare_folder(args.out)
    for count in args.passes:
        bag, out = folder / 'bag', folder / f'passes_{count}'
        shutil.rmtree(bag, ignore_errors=True)
        repeat_bag(args.sample / 'bag', bag, count, args.gap_s)
        cost = cost_of(['replay', str(bag), '--site', str(args.sample / 'site.yaml'),
                        '--out', str(out)], folder / 'log.txt')
        timings = json.loads((out / SUMMARY).read_text())['timings']
        rows.append((count, timings['duration_s'] / 3600, *count_passes(out), cost))
        shutil.rmtree(bag)
    print(long_table(rows).markdown())
    return 0


def run_many(args: argparse.Namespace) -> int:
    """Replay many tiny bags, and again when all are done; print the table."""
    rows = []
    folder = prepare_folder(args.out)
    source = folder / 'tiny'
    shutil.rmtree(source, ignore_errors=True)
    repeat_bag(args.sample / 'bag', source, 1, _GAP_S, pairs=_TINY)
    for count in args.bags:
        bags = [folder / 'bags' / f'bag{number:05d}' for number in range(count)]
        shutil.rmtree(folder / 'bags', ignore_errors=True)
        shutil.rmtree(folder / f'bags_{count}', ignore_errors=True)
        for bag in bags:
            shutil.copytree(source, bag)
        arguments = ['replay-many', *map(str, bags), '--site', str(args.sample / 'site.yaml'),
                     '--init', str(args.sample / 'init.yaml'), '--no-plots', '--jobs',
                     str(args.jobs), '--out', str(folder / f'bags_{count}')]
        first, again = (cost_of(arguments, folder / 'log.txt') for _ in range(2))
        passes = sum(count_passes(folder / f'bags_{count}' / bag.name)[0] for bag in bags)
        rows.append((count, passes, first, again))
        shutil.rmtree(folder / 'bags')
    print(many_table(rows).markdown())
    return 0
