# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``replay``: measure the vehicles of a stereo bag, offline and deterministically."""
from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass, field, replace
import math
from pathlib import Path
import time
from typing import Any, Mapping, Optional, Sequence

import cv2
import numpy as np
from tqdm import tqdm

from ..core.config import load_config, TrackerConfig
from ..core.errors import InputError
from ..core.records import PassResult, TrackUpdate, Verdict
from ..core.units import KMH_MPS, MPH_MPS
from ..io.atomic import prepare_folder
from ..io.bags import StereoBag
from ..io.results import (
    file_sha256, of_passes, software_versions, staged_run, stream_timings, write_run)
from ..pipeline.pipeline import SpeedPipeline, TRACKERS
from ..road.lanes import LanePath
from ..site.file import InitialFront, load_site
from ..site.init_file import load_init
from ..site.lane_paths import lane_paths
from ..site.refine.refiner import refine_site, RefinedSite
from ..site.refine.report import report, summary as report_summary, summary_lines
from ..site.write import site_text

REFINED_SITE = 'site.yaml'


@dataclass
class Run:
    """
    What one replay has gathered.

    :param updates: track updates, in time order.
    :param passes: results of the passes that ended.
    :param stamps_ns: stamp of each pair.
    :param strip: annotated frames, for the strip.
    :param wall_s: time spent in the pipeline, s.
    """

    updates: list[TrackUpdate] = field(default_factory=list)
    passes: list[PassResult] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    strip: list[Any] = field(default_factory=list)
    wall_s: float = 0.0


def add_parser(subparsers: Any) -> None:
    """Add the command and its options."""
    parser = subparsers.add_parser(
        'replay', help='measure the vehicles of a stereo bag, offline',
        description='Measure the vehicles of a stereo bag. The same bag, site and seed give the '
                    'same files, byte for byte.')
    parser.add_argument('bag', metavar='BAG', type=Path,
                        help='rosbag2 folder, .mcap or .db3 file, or ROS 1 .bag')
    parser.add_argument('--site', required=True, type=Path, help='site file (YAML)')
    parser.add_argument('--out', required=True, type=Path, metavar='DIR', help='folder to write')
    parser.add_argument('--refine-site', action='store_true',
                        help='find the lines of the site in the images first')
    parser.add_argument('--init', type=Path, help='init file (YAML) that marks the vehicles; '
                        'without it they are found automatically')
    parser.add_argument('--tracker', type=_tracker, default='constrained', metavar='NAME',
                        help=', '.join(TRACKERS) + ' (default: constrained)')
    parser.add_argument('--particles', type=int, metavar='N', help='number of particles')
    parser.add_argument('--seed', type=_seed, default=0, metavar='S', help='seed (default: 0)')
    parser.add_argument('--config', type=Path, metavar='YAML', help='parameters of the tracker')
    parser.add_argument('--left', metavar='TOPIC', help='topic of the left images')
    parser.add_argument('--right', metavar='TOPIC', help='topic of the right images')
    parser.add_argument('--tolerance-ms', type=_tolerance, metavar='MS',
                        help='largest difference between the stamps of a pair (default: equal '
                             'stamps, or the nearest where the bag has too few equal ones)')
    parser.add_argument('--no-plots', action='store_true', help='write no PNG files')
    parser.set_defaults(run=run)


def _tracker(text: str) -> str:
    if text not in TRACKERS:
        raise argparse.ArgumentTypeError(
            f'found {text!r}, wanted one of {", ".join(TRACKERS)}')
    return text


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f'found {text!r}, wanted a whole number, 0 or more')
    return int(text)


def _tolerance(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value <= 1000:
        raise argparse.ArgumentTypeError(f'found {text!r}, wanted milliseconds in [0, 1000]')
    return value


def run(args: argparse.Namespace) -> int:
    """Measure, then write everything, then print the table."""
    config = _config(args)
    site, marks = load_site(args.site), None if args.init is None else load_init(args.init)
    prepare_folder(args.out)
    if args.refine_site and args.site.resolve() == (args.out / REFINED_SITE).resolve():
        raise InputError('replay', '--out', args.out, 'a folder where the refined site does not '
                         f'overwrite {args.site}')
    tolerance = None if args.tolerance_ms is None else round(args.tolerance_ms * 1e6)
    with StereoBag(args.bag, left=args.left, right=args.right, tolerance_ns=tolerance) as bag:
        refined = None
        if args.refine_site:
            refined = refine_site(site, bag.rig, bag.pairs())
            figures = report(refined)
            print('\n'.join(summary_lines(refined, figures)))
            site = refined.site
        config = replace(config, **site.tolerances)
        bag.rig = site.corrected_rig(bag.rig)
        lanes = lane_paths(site, bag.rig)
        pipeline = SpeedPipeline(bag.rig, lanes, config, marks, seed=args.seed,
                                 tracker=args.tracker, where=str(args.init))
        if marks is not None:
            _check_frames(marks, bag.pair_count, args.init)
        result = measure(bag, pipeline, lanes, keep_frames=not args.no_plots)
        summary = summarize(args, config, bag, result, lanes)
        pairing = dict(bag.pairing)
    if refined is not None:
        summary['refinement'] = report_summary(refined, figures)
    write_all(args, lanes, result, summary, refined)
    print_lanes(lanes)
    print_table(result.passes)
    print(f'{pairing["pairs"]} pairs ({pairing["method"]} stamps; unpaired: '
          f'{pairing["unpaired_left"]} left, {pairing["unpaired_right"]} right), '
          f'{1e3 * result.wall_s / len(result.stamps_ns):.1f} ms per pair; in {args.out}')
    return 0


def _config(args: argparse.Namespace) -> TrackerConfig:
    config = load_config(args.config) if args.config else TrackerConfig()
    if args.particles is None:
        return config
    try:
        return replace(config, particles=args.particles)
    except InputError as error:
        raise InputError('replay', '--particles', error.found, error.wanted) from None


def _check_frames(marks: Sequence[InitialFront], pairs: int, where: Path) -> None:
    """Refuse a mark in a pair that never comes."""
    for index, mark in enumerate(marks):
        if mark.frame >= pairs:
            raise InputError(where, f'vehicles[{index}].frame', mark.frame,
                             f'below {pairs}, the number of pairs')


def measure(bag: StereoBag, pipeline: SpeedPipeline, lanes: Mapping[str, LanePath], *,
            keep_frames: bool) -> Run:
    """
    Run every pair of the bag through the pipeline.

    :param bag: an open bag.
    :param pipeline: the pipeline.
    :param lanes: the lanes, for the annotated frames.
    :param keep_frames: whether annotated frames are wanted.
    """
    result, frames = Run(), EvenSampler(9)
    for pair in tqdm(bag.pairs(), total=bag.pair_count, desc='replay', unit='pair', disable=None):
        start = time.perf_counter()
        updates = pipeline.process(pair)
        result.passes += pipeline.ended()
        result.wall_s += time.perf_counter() - start
        result.updates += updates
        result.stamps_ns.append(pair.stamp_ns)
        if keep_frames and updates and frames.wants():
            from ..report.overlay import draw
            frames.add(draw(pair, updates, lanes, bag.rig))
    start = time.perf_counter()
    result.passes += pipeline.finish()
    result.wall_s += time.perf_counter() - start
    result.passes.sort(key=lambda p: p.track)
    result.updates = of_passes(result.updates, result.passes)
    result.strip = frames.frames()
    return result


class EvenSampler:
    """Keeps evenly spaced items of a stream of unknown length, in bounded memory."""

    def __init__(self, count: int) -> None:
        self._count, self._step, self._seen = count, 1, 0
        self._kept: list[Any] = []

    def wants(self) -> bool:
        """Tell whether the next item is one to keep; call once per item."""
        self._seen += 1
        return (self._seen - 1) % self._step == 0

    def add(self, item: Any) -> None:
        """Keep an item; past twice the count, keep every other one from then on."""
        self._kept.append(item)
        if len(self._kept) > 2 * self._count:
            self._kept, self._step = self._kept[::2], 2 * self._step

    def frames(self) -> list[Any]:
        """Give at most ``count`` of those kept, evenly spaced, the first and the last of them."""
        chosen = np.linspace(0, len(self._kept) - 1, min(self._count, len(self._kept)))
        return [self._kept[i] for i in np.round(chosen).astype(int)]


def summarize(args: argparse.Namespace, config: TrackerConfig, bag: StereoBag,
              result: Run, lanes: Mapping[str, LanePath]) -> dict[str, Any]:
    """
    Gather what ``summary.json`` says; nothing in it depends on the machine's pace.

    :param args: the options.
    :param config: the tracker's parameters.
    :param bag: the bag, read to its end.
    :param result: the run.
    :param lanes: the lanes, for how well their picks agree.
    """
    return {
        'versions': software_versions(),
        'parameters': asdict(config),
        'tracker': args.tracker,
        'seed': args.seed,
        'refine_site': args.refine_site,
        'input': {'bag': args.bag.resolve().name, 'bag_sha256': bag.input_hash(),
                  'site_sha256': file_sha256(args.site),
                  'init_sha256': None if args.init is None else file_sha256(args.init)},
        'pairing': bag.pairing,
        'lanes': {lane.name: path_quality(lane) for lane in lanes.values()},
        'timings': stream_timings(result.stamps_ns),
        'passes': {verdict.value: sum(p.verdict is verdict for p in result.passes)
                   for verdict in Verdict},
    }


def path_quality(lane: LanePath) -> dict[str, float]:
    """Tell how long a lane's path is, how well its picks agree, and how well it is known."""
    return {'length_m': round(lane.path.length_m, 3),
            'residual_px': round(float(lane.residual_px), 3),
            'heading_std_across_deg': round(float(np.degrees(lane.heading_std_rad[0])), 4),
            'heading_std_up_deg': round(float(np.degrees(lane.heading_std_rad[1])), 4),
            'scale_std_percent': round(100 * lane.scale_std, 4)}


def print_lanes(lanes: Mapping[str, LanePath]) -> None:
    """Print how well each lane's path is known."""
    for lane in lanes.values():
        q = path_quality(lane)
        print(f'{lane.name}: path of {q["length_m"]:.1f} m, picks {q["residual_px"]:.2f} px '
              f'r.m.s. off it, heading ± {q["heading_std_across_deg"]:.4f}° across '
              f'and ± {q["heading_std_up_deg"]:.4f}° up')


def write_all(args: argparse.Namespace, lanes: Mapping[str, LanePath], result: Run,
              summary: Mapping[str, Any], refined: Optional[RefinedSite] = None) -> None:
    """
    Write everything beside the folder, then move it in, ``summary.json`` last.

    :param args: gives the folder, and whether plots are wanted.
    :param lanes: the lanes, for the plots.
    :param result: the run.
    :param summary: content of ``summary.json``.
    :param refined: the site it was measured with, to be kept with the results.
    """
    with staged_run(args.out) as stage:
        write_run(stage, result.updates, result.passes, dict(summary))
        if not args.no_plots:
            from ..report.overlay import strip
            from ..report.plots import write_plots
            write_plots(stage, result.updates, result.passes, lanes)
            if result.strip:
                cv2.imwrite(str(stage / 'strip.png'), strip(result.strip, width_px=480))
        if refined is not None:
            (stage / REFINED_SITE).write_text(site_text(refined.site), encoding='utf-8')


def print_table(passes: Sequence[PassResult]) -> None:
    """Print one line per pass, in the units that people read."""
    print(f'{"track":>5}  {"lane":<12} {"mph":>14} {"km/h":>14}  verdict')
    for p in passes:
        def shown(unit: float) -> str:
            if p.speed_mps is None or p.speed_std_mps is None:
                return '-'
            return f'{p.speed_mps / unit:.2f} ± {p.speed_std_mps / unit:.2f}'
        reason = f' ({p.reason})' if p.reason else ''
        lane = p.lane if p.lane_to == p.lane else f'{p.lane} > {p.lane_to}'
        print(f'{p.track:>5}  {lane:<12} {shown(MPH_MPS):>14} {shown(KMH_MPS):>14}  '
              f'{p.verdict.value}{reason}')
        if p.budget is not None:
            print(f'       1-sigma in mph: {p.budget.matching_mps / MPH_MPS:.3f} matching, '
                  f'{p.budget.path_mps / MPH_MPS:.3f} path, '
                  f'{p.budget.stamps_mps / MPH_MPS:.3f} stamps, '
                  f'{p.budget.calibration_mps / MPH_MPS:.3f} calibration')
