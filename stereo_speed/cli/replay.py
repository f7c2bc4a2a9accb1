# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``replay``: measure the vehicles of a stereo bag, offline and deterministically."""
from __future__ import annotations

import argparse
from dataclasses import replace
import math
from pathlib import Path
import sys
from typing import Any, Callable, Iterable, Mapping, Optional, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from .options import Subparsers
from ..core.errors import InputError
from ..core.records import InitialFront, PassResult, StereoPair, Verdict
from ..core.sampling import EvenSampler
from ..core.units import KMH_MPS, MPH_MPS
from ..io.atomic import prepare_folder
from ..io.bags import StereoBag
from ..io.boxes import BoxFeed
from ..io.results import file_sha256, software_versions, staged_run, stream_timings, write_run
from ..pipeline.assembly import MeasuringSite
from ..pipeline.config import load_pipeline_config, PipelineConfig
from ..pipeline.pipeline import SpeedPipeline, Step
from ..pipeline.registry import DETECTORS, Registry, TRACKERS
from ..pipeline.run import Run, run as run_pipeline
from ..report.overlay import draw, strip
from ..road.lanes import LanePath
from ..site.file import load_site
from ..site.init_file import load_init
from ..site.refine.report import report, summary as report_summary, summary_lines
from ..site.write import site_text
from ..steadying.report import steadiness_lines, steadiness_summary

REFINED_SITE = 'site.yaml'
_STRIP_FRAMES = 9  # annotated frames of a run


def add_parser(subparsers: Subparsers) -> None:
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
    parser.add_argument('--tracker', type=_one_of(TRACKERS), default='constrained',
                        metavar='NAME',
                        help=', '.join(TRACKERS.names) + ' (default: constrained)')
    parser.add_argument('--detector', type=_one_of(DETECTORS), default='plane_sweep',
                        metavar='NAME', help='finds the vehicles: '
                        + ', '.join(DETECTORS.names) + ' (default: plane_sweep)')
    parser.add_argument('--boxes', type=Path, metavar='CSV', help='boxes of vehicles in the left '
                        'images, for a detector that takes them')
    parser.add_argument('--particles', type=int, metavar='N', help='number of particles')
    parser.add_argument('--seed', type=_seed, default=0, metavar='S', help='seed (default: 0)')
    parser.add_argument('--config', type=Path, metavar='YAML', help='parameters')
    parser.add_argument('--left', metavar='TOPIC', help='topic of the left images')
    parser.add_argument('--right', metavar='TOPIC', help='topic of the right images')
    parser.add_argument('--tolerance-ms', type=_tolerance, metavar='MS',
                        help='largest difference between the stamps of a pair (default: equal '
                             'stamps, or the nearest where the bag has too few equal ones)')
    parser.add_argument('--no-plots', action='store_true', help='write no PNG files')
    parser.set_defaults(run=run)


def _one_of(registry: Registry[Any]) -> Callable[[str], str]:
    """Return a parser of the names of a registry."""
    def parse(text: str) -> str:
        if text not in registry.names:
            raise argparse.ArgumentTypeError(
                f'found {text!r}, wanted one of {", ".join(registry.names)}')
        return text
    return parse


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
    site = load_site(args.site)
    annotations = None if args.init is None else load_init(args.init)
    prepare_folder(args.out)
    if args.refine_site and args.site.resolve() == (args.out / REFINED_SITE).resolve():
        raise InputError('replay', '--out', args.out, 'a folder where the refined site does not '
                         f'overwrite {args.site}')
    tolerance = None if args.tolerance_ms is None else round(args.tolerance_ms * 1e6)
    with StereoBag(args.bag, left=args.left, right=args.right, tolerance_ns=tolerance) as bag:
        place = MeasuringSite.of(site, bag.rig, bag.pairs() if args.refine_site else None,
                                 config.site)
        figures = None if place.refined is None else report(place.refined)
        if place.refined is not None and figures is not None:
            print('\n'.join(summary_lines(place.refined, figures)))
        if place.not_refined:
            print(f'warning: site not refined, measured as it was read: {place.not_refined}',
                  file=sys.stderr)
        pipeline = place.pipeline(config, annotations, seed=args.seed, where=str(args.init))
        feed = BoxFeed(pipeline.detector, args.boxes, args.detector)
        if annotations is not None:
            _check_frames(annotations, bag.pair_count, args.init)
        result, frames = measure(bag, pipeline, keep_frames=not args.no_plots, feed=feed)
        summary = summarize(args, config.with_tolerances(place.site.tolerances), bag, result,
                            place.lanes)
        pairing = dict(bag.pairing)
    if place.refined is not None and figures is not None:
        summary['refinement'] = report_summary(place.refined, figures)
    elif place.not_refined:
        summary['refinement'] = {'not_refined': place.not_refined}
    if pipeline.steadier is not None:
        summary['steadiness'] = steadiness_summary(pipeline.steadier.state())
    write_all(args, place, result, frames, summary)
    print_lanes(place.lanes)
    print_table(result.passes)
    if pipeline.steadier is not None:
        print(''.join(f'{line}\n' for line in steadiness_lines(pipeline.steadier.state())), end='')
    print(f'{pairing["pairs"]} pairs ({pairing["method"]} stamps; unpaired: '
          f'{pairing["unpaired_left"]} left, {pairing["unpaired_right"]} right), '
          f'{1e3 * result.wall_s / len(result.stamps_ns):.1f} ms per pair; in {args.out}')
    if feed.boxes:
        print(f'{len(feed.boxes)} stamps of {args.boxes} are of no pair: their boxes were not '
              'used')
    return 0


def _config(args: argparse.Namespace) -> PipelineConfig:
    config = load_pipeline_config(args.config, tracker=args.tracker, detector=args.detector)
    if args.particles is None:
        return config
    try:
        return replace(config, shared=replace(config.shared, particles=args.particles))
    except InputError as error:
        raise InputError('replay', '--particles', error.found, error.wanted) from None


def _check_frames(annotations: Sequence[InitialFront], pairs: int, where: Path) -> None:
    """Refuse an annotation in a pair that never comes."""
    for index, front in enumerate(annotations):
        if front.frame >= pairs:
            raise InputError(where, f'vehicles[{index}].frame', front.frame,
                             f'below {pairs}, the number of pairs')


def measure(bag: StereoBag, pipeline: SpeedPipeline, *, keep_frames: bool,
            feed: Optional[BoxFeed] = None) -> tuple[Run, list[NDArray[np.uint8]]]:
    """
    Run every pair of a bag through a pipeline, with a progress bar.

    :param bag: an open bag.
    :param pipeline: the pipeline.
    :param keep_frames: whether annotated frames are wanted.
    :param feed: gives the detector boxes; None where it takes none.
    :return: the run, and annotated frames evenly spread over it.
    """
    frames: EvenSampler[NDArray[np.uint8]] = EvenSampler(_STRIP_FRAMES)

    def keep(pair: StereoPair, step: Step) -> None:
        if step.updates and frames.wants():
            frames.add(draw(pair, step.updates, pipeline.lanes, pipeline.rig))
    pairs: Iterable[StereoPair] = tqdm(
        bag.pairs(), total=bag.pair_count, desc='replay', unit='pair', disable=None)
    pairs = pairs if feed is None else feed.through(pairs)
    result = run_pipeline(pipeline, pairs, keep if keep_frames else None)
    return result, frames.items()


def summarize(args: argparse.Namespace, config: PipelineConfig, bag: StereoBag,
              result: Run, lanes: Mapping[str, LanePath]) -> dict[str, Any]:
    """
    Gather what ``summary.json`` says; nothing in it depends on the machine's pace.

    :param args: the options.
    :param config: the parameters.
    :param bag: the bag, read to its end.
    :param result: the run.
    :param lanes: the lanes, for how well their picks agree.
    """
    return {
        'versions': software_versions(),
        **config.summary(),
        'seed': args.seed,
        'refine_site': args.refine_site,
        'input': {'bag': args.bag.resolve().name, 'bag_sha256': bag.input_hash(),
                  'site_sha256': file_sha256(args.site),
                  'init_sha256': None if args.init is None else file_sha256(args.init),
                  'boxes_sha256': None if args.boxes is None else file_sha256(args.boxes)},
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


def write_all(args: argparse.Namespace, place: MeasuringSite, result: Run,
              frames: Sequence[NDArray[np.uint8]], summary: Mapping[str, Any]) -> None:
    """
    Write everything beside the folder, then move it in, ``summary.json`` last.

    :param args: gives the folder, and whether plots are wanted.
    :param place: the site as measured at; kept with the results where it was refined.
    :param result: the run.
    :param frames: annotated frames for the strip.
    :param summary: content of ``summary.json``.
    """
    with staged_run(args.out) as stage:
        write_run(stage, result.updates, result.passes, dict(summary))
        if not args.no_plots:
            from ..report.plots import write_plots  # matplotlib takes a second to load
            write_plots(stage, result.updates, result.passes, place.lanes)
            if frames:
                cv2.imwrite(str(stage / 'strip.png'), strip(frames, width_px=480))
        if place.refined is not None:
            (stage / REFINED_SITE).write_text(site_text(place.site), encoding='utf-8')


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
