# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``replay``: measure the vehicles of a stereo bag, offline.

The same bag, site and seed give the same files, byte for byte.
"""
from __future__ import annotations

import argparse
from contextlib import closing, ExitStack, nullcontext
from dataclasses import dataclass, replace
import math
from pathlib import Path
import sys
from typing import Any, Callable, Iterable, Iterator, Mapping, Optional, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from .replay_evidence import add_evidence_options, check_options, ReplayEvidence
from .replay_helpers import Helpers
from .replay_parts import identity_of, is_kept, PART_PAIRS, Parts
from .replay_report import add_report_options, run_warnings, RunPictures
from ..core.errors import InputError
from ..core.passes import PassResult, Verdict
from ..core.records import InitialFront, StereoPair
from ..core.sampling import EvenSampler
from ..core.units import KMH_MPS, MPH_MPS
from ..io.ahead import ahead
from ..io.atomic import prepare_folder
from ..io.bags import StereoBag
from ..io.boxes import BoxFeed
from ..io.results import software_versions, staged_run, stream_timings, TRACKS, write_run
from ..io.track_rows import TrackRows
from ..pipeline.assembly import MeasuringSite
from ..pipeline.conclusions import Later
from ..pipeline.config import load_pipeline_config, PipelineConfig
from ..pipeline.pipeline import SpeedPipeline, Step
from ..pipeline.registry import DETECTORS, Registry, TRACKERS
from ..pipeline.run import gather, Observer, Run, run as run_pipeline
from ..pipeline.stream_doubt import StreamDoubt
from ..report.overlay import draw, strip
from ..road.lanes import LanePath
from ..site.file import load_site, Site
from ..site.init_file import load_init
from ..site.refine.report import report, summary as report_summary, summary_lines
from ..site.write import site_text
from ..steadying.report import steadiness_lines, steadiness_summary

REFINED_SITE = 'site.yaml'
_STRIP_FRAMES = 9  # annotated frames in ``strip.png``


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``replay``."""
    parser.add_argument('bag', metavar='BAG', type=Path,
                        help='rosbag2 folder, .mcap or .db3 file, or ROS 1 .bag')
    add_options(parser)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that do not depend on the bag."""
    parser.add_argument('--site', required=True, type=Path, help='site file (YAML)')
    parser.add_argument('--out', required=True, type=Path, metavar='DIR', help='folder to write')
    parser.add_argument('--refine-site', action='store_true',
                        help='first refine the site by the images of the bag')
    parser.add_argument('--init', type=Path, help='init file (YAML) that marks the vehicles; '
                        'without it they are found automatically')
    parser.add_argument('--tracker', type=_one_of(TRACKERS), default='constrained',
                        metavar='NAME',
                        help=', '.join(TRACKERS.names) + ' (default: constrained)')
    parser.add_argument('--detector', type=_one_of(DETECTORS), default='plane_sweep',
                        metavar='NAME', help='detector that finds the vehicles: '
                        + ', '.join(DETECTORS.names) + ' (default: plane_sweep)')
    parser.add_argument('--boxes', type=Path, metavar='CSV', help='boxes of vehicles in the left '
                        'images, for a detector that uses boxes')
    parser.add_argument('--particles', type=int, metavar='N', help='number of particles')
    parser.add_argument('--seed', type=_seed, default=0, metavar='S', help='seed (default: 0)')
    parser.add_argument('--config', type=Path, metavar='YAML', help='parameters')
    parser.add_argument('--left', metavar='TOPIC', help='topic of the left images')
    parser.add_argument('--right', metavar='TOPIC', help='topic of the right images')
    parser.add_argument('--tolerance-ms', type=_tolerance, metavar='MS',
                        help='largest difference between the stamps of a pair (default: equal '
                             'stamps, or the nearest if the bag has too few equal ones)')
    add_evidence_options(parser)
    add_report_options(parser)
    parser.add_argument('--no-plots', action='store_true', help='write no PNG files')


def _one_of(registry: Registry[Any]) -> Callable[[str], str]:
    """Return a function that accepts the names of a registry."""
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


def check(args: argparse.Namespace) -> None:
    """Check the options and files that all bags share, and refuse bad ones."""
    _config(args)
    load_site(args.site)
    if args.init is not None:
        load_init(args.init)


def run(args: argparse.Namespace, *, beside: bool = True) -> int:
    """
    Measure, write all files, then print the table.

    :param beside: whether helper processes may use other cores.
    """
    with RunPictures(args) as pictures:
        return _run(args, pictures, beside)


@dataclass(frozen=True)
class _Inputs:
    """
    The files that a run is given besides the bag, as they were when it began.

    :param site: the site.
    :param annotations: the marked fronts; None without an init file.
    :param sha256: SHA-256 of each file, for ``summary.json``; None for one that was not given.
    :param identity: everything that determines the results, with all files that are given.
    """

    site: Site
    annotations: Optional[Sequence[InitialFront]]
    sha256: Mapping[str, Optional[str]]
    identity: Mapping[str, Any]

    @classmethod
    def of(cls, args: argparse.Namespace) -> _Inputs:
        """Read the files; that of the boxes is read as it is used."""
        site = load_site(args.site)
        annotations = None if args.init is None else load_init(args.init)
        identity = identity_of(args)
        sha256 = {f'{name}_sha256': None if path is None
                  else identity['inputs'].get(str(path.resolve()))
                  for name, path in (('site', args.site), ('init', args.init),
                                     ('boxes', args.boxes))}
        return cls(site, annotations, sha256, identity)


@dataclass(frozen=True)
class _Measured:
    """
    What came of a bag.

    :param place: the site as used.
    :param result: the run.
    :param frames: annotated frames for the strip.
    :param summary: content of ``summary.json``.
    :param pairing: how the images were paired, as reported by the bag.
    :param rig: lines on the steadiness of the rig and the focus of its cameras; empty where there
        is nothing to say.
    :param evidence: lines on the evidence that was written.
    :param unused_boxes: number of stamps with boxes that match no pair.
    :param parts: the parts it was measured in, to be removed once everything is written; None for
        a run that was not divided.
    """

    place: MeasuringSite
    result: Run
    frames: list[NDArray[np.uint8]]
    summary: Mapping[str, Any]
    pairing: Mapping[str, Any]
    rig: Sequence[str]
    evidence: Sequence[str]
    unused_boxes: int
    parts: Optional[Parts]


def _run(args: argparse.Namespace, pictures: RunPictures, beside: bool) -> int:
    config = _config(args)
    check_options(args)
    inputs = _Inputs.of(args)
    prepare_folder(args.out)
    if args.refine_site and args.site.resolve() == (args.out / REFINED_SITE).resolve():
        raise InputError('replay', '--out', args.out, 'a folder where the refined site does not '
                         f'overwrite {args.site}')
    tolerance = None if args.tolerance_ms is None else round(args.tolerance_ms * 1e6)
    rows = TrackRows(args.out)
    with StereoBag(args.bag, left=args.left, right=args.right, tolerance_ns=tolerance) as bag, \
            Helpers.of(bag.pair_count, config.detector if inputs.annotations is None else None,
                       beside=beside) as helpers:
        if helpers.ahead:  # a thread, thus only now that the processes are forked
            bag.hash_ahead()
        place = MeasuringSite.of(
            inputs.site, bag.rig, bag.pairs() if args.refine_site else None, config.site,
            rest_by=bag.pairs)
        done = _measured(args, config, bag, place, inputs, helpers, rows, pictures)
    write_all(args, place, done.result, rows, done.frames, done.summary, pictures, run_warnings(
        place, done.pairing, done.rig, done.result.stamps_ns[-1]))
    if done.parts is not None:
        done.parts.remove()
    _tell(args, done)
    return 0


def _measured(args: argparse.Namespace, config: PipelineConfig, bag: StereoBag,
              place: MeasuringSite, inputs: _Inputs, helpers: Helpers, rows: TrackRows,
              pictures: RunPictures) -> _Measured:
    """Measure the pairs of a bag at a site, and sum up what came of it."""
    refinement, annotations = _refinement(place), inputs.annotations

    def fresh() -> SpeedPipeline:
        return place.pipeline(
            config, annotations, conclusions=helpers.later, detect=helpers.detect,
            seed=args.seed, where=str(args.init))
    pipeline = fresh()
    feed = BoxFeed(pipeline.detector, args.boxes, args.detector)
    if annotations is not None:
        _check_frames(annotations, bag.pair_count, args.init)
    evidence = ReplayEvidence.of(args, bag, place, config)
    draw_pair = pictures.observer(place, bag.rate_hz)

    def observe(pair: StereoPair, step: Step) -> None:
        evidence.observe(pair, step)
        draw_pair(pair, step)
    parts = None if args.boxes is not None else Parts(
        args.out if is_kept(args) and bag.pair_count > PART_PAIRS else None,
        inputs.identity, fresh, PART_PAIRS)
    with evidence, parts or nullcontext():
        result, frames = measure(
            bag, pipeline, keep_frames=args.report or not args.no_plots, feed=feed,
            observe=observe, rows=rows, parts=parts, later=helpers.later,
            read_ahead=helpers.ahead)
        evidence.finish(result.passes)
    of_rig, rig_lines = _rig(pipeline.doubt)
    summary = {
        **summarize(args, config.with_tolerances(place.site.tolerances), bag, result, place.lanes,
                    inputs.sha256),
        **evidence.summary(), **refinement, **of_rig}
    return _Measured(place, result, frames, summary, dict(bag.pairing), rig_lines,
                     evidence.lines(), len(feed.boxes), parts)


def _rig(doubt: StreamDoubt) -> tuple[dict[str, Any], list[str]]:
    """Return what was found of the rig, for ``summary.json``, and as lines for the user."""
    focus = doubt.focus.state
    summary, lines = {'focus': focus.summary()}, [focus.warning()] if focus.warning() else []
    if doubt.steadier is not None:
        steady = doubt.steadier.state()
        summary['steadiness'] = steadiness_summary(steady)
        lines = [*steadiness_lines(steady), *lines]
    return summary, lines


def _refinement(place: MeasuringSite) -> dict[str, Any]:
    """Print how the site was refined, or why not, and return it for ``summary.json``."""
    if place.not_refined:
        print(f'warning: site not refined, used as written: {place.not_refined}',
              file=sys.stderr)
        return {'refinement': {'not_refined': place.not_refined}}
    if place.refined is None:
        return {}
    figures = report(place.refined)
    print('\n'.join(summary_lines(place.refined, figures)))
    return {'refinement': report_summary(place.refined, figures)}


def _tell(args: argparse.Namespace, done: _Measured) -> None:
    """Print the passes, and what else a user should know of the run."""
    print_lanes(done.place.lanes)
    print_table(done.result.passes)
    print(''.join(f'{line}\n' for line in (*done.evidence, *done.rig)), end='')
    pairing, result = done.pairing, done.result
    print(f'{pairing["pairs"]} pairs ({pairing["method"]} stamps; unpaired: '
          f'{pairing["unpaired_left"]} left, {pairing["unpaired_right"]} right), '
          f'{1e3 * result.wall_s / len(result.stamps_ns):.1f} ms per pair; results in {args.out}')
    if result.kept is not None and not args.no_plots:
        print(f'the plots show the first {len(result.kept)} of {len(result.passes)} passes')
    if done.unused_boxes:
        print(f'{done.unused_boxes} stamps of {args.boxes} match no pair: their boxes were not '
              'used')


def _config(args: argparse.Namespace) -> PipelineConfig:
    config = load_pipeline_config(args.config, tracker=args.tracker, detector=args.detector)
    if args.particles is None:
        return config
    try:
        return replace(config, shared=replace(config.shared, particles=args.particles))
    except InputError as error:
        raise InputError('replay', '--particles', error.found, error.wanted) from None


def _check_frames(annotations: Sequence[InitialFront], pairs: int, where: Path) -> None:
    """Refuse an annotation in a pair that the bag does not have."""
    for index, front in enumerate(annotations):
        if front.frame >= pairs:
            raise InputError(where, f'vehicles[{index}].frame', front.frame,
                             f'below {pairs}, the number of pairs')


def measure(bag: StereoBag, pipeline: SpeedPipeline, *, keep_frames: bool,
            feed: Optional[BoxFeed] = None, observe: Optional[Observer] = None,
            rows: Optional[TrackRows] = None, parts: Optional[Parts] = None,
            later: Optional[Later] = None, read_ahead: bool = False
            ) -> tuple[Run, list[NDArray[np.uint8]]]:
    """
    Run every pair of a bag through a pipeline, with a progress bar.

    :param bag: an open bag.
    :param pipeline: the pipeline.
    :param keep_frames: whether annotated frames are wanted.
    :param feed: passes boxes to the detector; None for a detector that takes none.
    :param observe: called with each pair and its :class:`Step`.
    :param rows: writes the updates to disk, for bags whose updates do not fit in memory.
    :param parts: divides the run into parts that can be resumed; None runs it as one.
    :param later: measures finished passes; None has the pipeline do it.
    :param read_ahead: whether a thread reads and decodes pairs ahead.
    :return: the run, and annotated frames evenly spread over it.
    """
    frames: EvenSampler[NDArray[np.uint8]] = EvenSampler(_STRIP_FRAMES)
    done, first = Run(), 0
    if parts is not None and parts.done is not None:
        first = parts.done.pairs
        print(f'resuming after {first} of {bag.pair_count} pairs, done by an earlier run')
        for step, open_tracks in parts.steps():
            gather(done, step, open_tracks, rows)
            if keep_frames and step.updates and frames.wants():
                frames.add(parts.next_frame())
        done.stamps_ns, done.wall_s = bag.stamps_ns[:first], parts.done.wall_s
        pipeline.next_track = parts.done.next_track

    def keep(pair: StereoPair, step: Step) -> None:
        if observe is not None:
            observe(pair, step)
        if keep_frames and step.updates and frames.wants():
            frames.add(draw(pair, step.updates, pipeline.lanes, pipeline.rig))
            if parts is not None:
                parts.add_frame(frames.kept[-1])
    with ExitStack() as open_:  # reading ahead stops before the bag is closed
        read = open_.enter_context(
            closing(ahead(bag.pairs()))) if read_ahead else bag.pairs()
        pairs: Iterable[StereoPair] = tqdm(
            _from(read, first, pipeline), initial=first, total=bag.pair_count, desc='replay',
            unit='pair', disable=None)
        pairs = pairs if feed is None else feed.through(pairs)
        result = run_pipeline(pipeline, pairs, keep, rows, so_far=done,
                              relay=parts, later=later)
    return result, frames.items()


def _from(pairs: Iterable[StereoPair], first: int, pipeline: SpeedPipeline
          ) -> Iterator[StereoPair]:
    """Yield the pairs from an index on; earlier ones only update rig motion and clock."""
    for pair in pairs:
        if pair.index < first:
            pipeline.look(pair)
        else:
            yield pair


def summarize(args: argparse.Namespace, config: PipelineConfig, bag: StereoBag,
              result: Run, lanes: Mapping[str, LanePath], files: Mapping[str, Optional[str]]
              ) -> dict[str, Any]:
    """
    Return the content of ``summary.json``; it does not depend on the machine's speed.

    :param args: the options.
    :param config: the parameters.
    :param bag: the bag, read to its end.
    :param result: the run.
    :param lanes: the lanes, whose path quality is reported.
    :param files: SHA-256 of the other input files.
    """
    return {
        'versions': software_versions(),
        **config.summary(),
        'seed': args.seed,
        'refine_site': args.refine_site,
        'input': {'bag': args.bag.resolve().name, 'bag_sha256': bag.input_hash(),
                  **files},
        'pairing': bag.pairing,
        'lanes': {lane.name: path_quality(lane) for lane in lanes.values()},
        'timings': stream_timings(result.stamps_ns),
        'passes': {verdict.value: sum(p.verdict is verdict for p in result.passes)
                   for verdict in Verdict},
    }


def path_quality(lane: LanePath) -> dict[str, Optional[float]]:
    """Return length, pick residual and 1-sigmas of a lane's path, and its speed limit."""
    limit = lane.speed_limit_mps
    return {'speed_limit_mps': None if limit is None else round(limit, 5),
            'length_m': round(lane.path.length_m, 3),
            'residual_px': round(float(lane.residual_px), 3),
            'heading_std_across_deg': round(float(np.degrees(lane.heading_std_rad[0])), 4),
            'heading_std_up_deg': round(float(np.degrees(lane.heading_std_rad[1])), 4),
            'scale_std_percent': round(100 * lane.scale_std, 4)}


def print_lanes(lanes: Mapping[str, LanePath]) -> None:
    """Print length, pick residual and heading 1-sigma of each lane's path."""
    for lane in lanes.values():
        q = path_quality(lane)
        print(f'{lane.name}: path of {q["length_m"]:.1f} m, picks {q["residual_px"]:.2f} px '
              f'r.m.s. from it, heading ± {q["heading_std_across_deg"]:.4f}° across '
              f'and ± {q["heading_std_up_deg"]:.4f}° up')


def write_all(args: argparse.Namespace, place: MeasuringSite, result: Run, rows: TrackRows,
              frames: Sequence[NDArray[np.uint8]], summary: Mapping[str, Any],
              pictures: RunPictures, warnings: Sequence[str]) -> None:
    """
    Write all files into a staging folder, then move them into place, ``summary.json`` last.

    :param args: holds the output folder, and whether plots are wanted.
    :param place: the site as used; written with the results where it was refined.
    :param result: the run.
    :param rows: the rows of ``tracks.csv``; closed after they are written.
    :param frames: annotated frames for the strip.
    :param summary: content of ``summary.json``.
    :param pictures: writes report and video.
    :param warnings: warnings for the report.
    """
    with rows, staged_run(args.out) as stage:
        rows.save(stage / TRACKS)
        write_run(stage, None, result.passes, dict(summary))
        if not args.no_plots:
            from ..report.plots import write_plots  # matplotlib takes a second to load
            write_plots(stage, result.updates, result.passes, place.lanes, unit=pictures.unit)
            if frames:
                cv2.imwrite(str(stage / 'strip.png'), strip(frames, width_px=480))
        pictures.write(stage, place, result, frames, summary, warnings)
        if place.refined is not None:
            (stage / REFINED_SITE).write_text(site_text(place.site), encoding='utf-8')


def print_table(passes: Sequence[PassResult]) -> None:
    """Print the passes with their speeds in mph and km/h."""
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
        if p.second is not None and p.second.speed_mps is not None:
            print(f'       second estimate: {p.second.speed_mps / MPH_MPS:.2f} ± '
                  f'{(p.second.speed_std_mps or 0.0) / MPH_MPS:.2f} mph, {p.second.pairs} pairs')
        if p.budget is not None:
            print(f'       1-sigma in mph: {p.budget.matching_mps / MPH_MPS:.3f} matching, '
                  f'{p.budget.path_mps / MPH_MPS:.3f} path, '
                  f'{p.budget.stamps_mps / MPH_MPS:.3f} stamps, '
                  f'{p.budget.calibration_mps / MPH_MPS:.3f} calibration')
