# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``traffic``: measure a simulated stream of traffic, found automatically, and tabulate it."""
from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
import queue as queues
import tempfile
from typing import Any, Iterator, Mapping, Optional, Union

import cv2
import numpy as np
from tqdm import tqdm
import yaml

from ..evaluation import lane_changes, traffic as evaluation
from ..evaluation.drives import SITES
from ..sim.config import RIGS
from ..sim.sequence import exact_site
from ..sim.traffic import TrafficPair, TrafficStream
from ..sim.traffic_config import LIGHTS, traffic_config, TrafficConfig
from ..sim.truth import TRAFFIC_COLUMNS, write_truth
from ...core.config import TrackerConfig
from ...core.errors import InputError
from ...core.records import StereoPair
from ...geometry.rig import StereoRig
from ...io.atomic import prepare_folder
from ...io.results import software_versions, staged_run, stream_timings, write_run
from ...pipeline.assembly import make_pipeline
from ...pipeline.config import PipelineConfig
from ...pipeline.pipeline import SpeedPipeline
from ...pipeline.run import Run, run as run_pipeline
from ...road.lanes import LanePath
from ...site.file import load_site
from ...site.lane_paths import lane_paths
from ...site.refine.refiner import refine_site

TRUTH = 'truth.csv'
WAITING_PAIRS = 8  # rendered and not yet measured, at most
REFINE_PAIRS, REFINE_FPS = 40, 1.0
Message = Union[TrafficPair, Exception, None]


@dataclass(frozen=True)
class Measured:
    """
    What came of a stream.

    :param scorer: has seen truth and tracks.
    :param run: the run.
    :param truth: rows of ``truth.csv``.
    """

    scorer: evaluation.TrafficScorer
    run: Run
    truth: list[Mapping[str, Any]]


def _number(kind: type, low: float, high: float) -> Any:
    def parse(text: str) -> Any:
        value = kind(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f'{text} is not in [{low:g}, {high:g}]')
        return value
    parse.__name__ = kind.__name__
    return parse


def add_parser(subparsers: Any) -> None:
    """Add the ``traffic`` command."""
    parser = subparsers.add_parser(
        'traffic', help='measure simulated traffic, found automatically', description=__doc__)
    add = parser.add_argument
    add('--minutes', type=_number(float, 0.05, 600), default=10.0, help='length of the stream')
    add('--vehicles', type=_number(int, 1, 5000), default=200, help='how many drive past')
    add('--fps', type=_number(float, 0.5, 60), default=10.0, help='pairs per second')
    add('--lanes', type=int, choices=(1, 2, 3), default=3)
    add('--receding', type=int, choices=(0, 1, 2), default=0,
        help='lanes, from the left, whose vehicles drive away and show their rears')
    add('--light', choices=sorted(LIGHTS), default='day')
    add('--rig', choices=sorted(RIGS), default='parallel')
    add('--seed', type=_number(int, 0, 2 ** 63), default=0)
    add('--particles', type=int, default=TrackerConfig().particles)
    add('--jobs', type=int, choices=(1, 2), default=2,
        help='2 to render in a process of its own (default)')
    where = parser.add_mutually_exclusive_group()
    where.add_argument('--out', type=Path, metavar='DIR',
                       help='write tracks.csv, passes.csv, summary.json and truth.csv there')
    where.add_argument('--bag', type=Path, metavar='DIR',
                       help='measure nothing, write the stream as a bag with site and truth')
    where.add_argument('--lane-changes', type=_number(int, 1, 1000), metavar='SEEDS',
                       help='in place of a stream, so many of each of the lane changes of the '
                            '2012 paper, marked, beside a tracker that holds to the path')
    add('--lines', choices=SITES, default='refined',
        help='how the lines of the road are known: as clicked, clicked and refined by the images '
             '(default), or exactly')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """
    Simulate, measure, print the table, and write the files.

    :raises InputError: parameters that do not fit, or a folder that cannot be written.
    """
    if args.lane_changes is not None:
        return _tabulate_changes(args)
    if args.receding >= args.lanes and args.receding:
        raise InputError('traffic', '--receding', args.receding, f'fewer than {args.lanes}')
    config = traffic_config(
        args.light, args.lanes, args.receding, args.fps, args.minutes, args.vehicles,
        rig=RIGS[args.rig])
    if args.bag is not None:
        # Only writing bags needs rosbags.
        from ..sim.write import write_traffic_bag
        print(write_traffic_bag(stream_of(config, args.seed), args.bag, compressed=True))
        return 0
    parameters = PipelineConfig(replace(TrackerConfig(), particles=args.particles))
    if args.out is not None:
        prepare_folder(args.out)
    pairs = round(args.minutes * 60 * args.fps)
    rig, lanes = known_road(config, args.seed, args.lines)
    result = measure(config, args.seed, make_pipeline(rig, lanes, parameters, seed=args.seed),
                     list(lanes), args.jobs, pairs)
    score = result.scorer.score()
    name = (f'{args.minutes:g} min, {args.fps:g} fps, {args.lanes} lanes'
            f'{f", {args.receding} receding" if args.receding else ""}, {args.light}')
    if args.out is not None:
        _write(args, result, parameters, score)
    print(evaluation.HEADER)
    print(evaluation.row(name, score, 1e3 * result.run.cpu_s / max(len(result.run.stamps_ns), 1)))
    return 0


def _tabulate_changes(args: argparse.Namespace) -> int:
    """Measure the paper's lane changes and print their table."""
    TrackerConfig(particles=args.particles)  # refuse before the work begins
    seeds = range(args.seed, args.seed + args.lane_changes)
    tasks = [(case, seed, args.particles, args.lines)
             for case in lane_changes.CASES for seed in seeds]
    with ProcessPoolExecutor(args.jobs, mp_context=get_context('spawn')) as pool:
        errors = list(tqdm(pool.map(_measure_changes, tasks), total=len(tasks), unit='pass',
                           desc='lane changes', disable=None))
    print(lane_changes.HEADER)
    for case in lane_changes.CASES:
        for i, tracker in enumerate(lane_changes.TRACKERS):
            print(lane_changes.row(case, tracker, [
                e[i] for e, task in zip(errors, tasks) if task[0] == case]))
    return 0


def _measure_changes(task: tuple[str, int, int, str]) -> list[lane_changes.ChangeError]:
    """Measure one lane change in a worker: one thread each, the passes fill the cores."""
    cv2.setNumThreads(1)
    return lane_changes.measure_changes(*task)


def stream_of(config: TrafficConfig, seed: int) -> TrafficStream:
    """Make the stream of a seed."""
    return TrafficStream(config, np.random.default_rng(seed))


def known_road(config: TrafficConfig, seed: int, lines: str
               ) -> tuple[StereoRig, dict[str, LanePath]]:
    """
    Give rig and lanes as a person would hand them over, through a site file.

    :param config: the traffic.
    :param seed: of the stream.
    :param lines: one of ``SITES``; refined ones are refined by a few pairs of traffic before.
    """
    stream = stream_of(config, seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'site.yaml'
        path.write_text(yaml.safe_dump(
            dict(exact_site(stream.scene) if lines == 'exact' else stream.site)))
        site = load_site(path)
    if lines != 'refined':
        return stream.rig, lane_paths(site, stream.rig)
    minutes = REFINE_PAIRS / REFINE_FPS / 60
    early = replace(
        config, scene=replace(config.scene, fps=REFINE_FPS, drop=(), gaps_s=()), minutes=minutes,
        vehicles=max(round(config.vehicles * minutes / config.minutes), 1))
    refined = refine_site(site, stream.rig, (one.pair for one in stream_of(early, seed)))
    return refined.rig, refined.lanes


def measure(config: TrafficConfig, seed: int, pipeline: SpeedPipeline, lanes: list[str],
            jobs: int, total: Optional[int] = None) -> Measured:
    """
    Run a stream through the pipeline.

    :param config: the traffic.
    :param seed: of the stream.
    :param pipeline: the pipeline.
    :param lanes: names of the lanes, the rightmost first.
    :param jobs: 2 to render in a process of its own.
    :param total: expected number of pairs, for the progress shown.
    """
    scorer, truth = evaluation.TrafficScorer(lanes), []
    source = rendered(config, seed) if jobs > 1 else iter(stream_of(config, seed))

    def pairs() -> Iterator[StereoPair]:
        for one in tqdm(source, total=total, desc='traffic', unit='pair', disable=None):
            truth.append(one.truth)
            yield one.pair
    run = run_pipeline(pipeline, pairs(), lambda pair, step: scorer.add(truth[-1], step.updates))
    scorer.close(run.passes)
    return Measured(scorer, run, [row for rows in truth for row in rows])


def rendered(config: TrafficConfig, seed: int) -> Iterator[TrafficPair]:
    """
    Give the pairs of a stream that another process renders.

    :raises StereoSpeedError: what went wrong there.
    """
    context = get_context('spawn')
    queue = context.Queue(WAITING_PAIRS)
    worker = context.Process(target=_render, args=(config, seed, queue), daemon=True)
    worker.start()
    try:
        while True:
            one = _next(queue, worker)
            if one is None:
                return
            if isinstance(one, Exception):
                raise one
            yield one
    finally:
        worker.terminate()
        worker.join()


def _next(queue: Any, worker: Any) -> Message:
    """Wait for the next message, as long as there is somebody to send it."""
    while True:
        try:
            message: Message = queue.get(timeout=5.0)
            return message
        except queues.Empty:
            if not worker.is_alive() and queue.empty():
                raise RuntimeError(
                    f'the renderer ended with exit code {worker.exitcode}') from None


def _render(config: TrafficConfig, seed: int, queue: Any) -> None:
    """Render in a process of its own."""
    cv2.setNumThreads(1)
    try:
        for one in stream_of(config, seed):
            queue.put(one)
        queue.put(None)
    except Exception as error:  # to be raised where somebody sees it
        queue.put(error)


def _write(args: argparse.Namespace, result: Measured, config: PipelineConfig,
           score: evaluation.TrafficScore) -> None:
    """Write the truth and the files of the run, all of them or none."""
    counts = {k: v for k, v in asdict(score).items() if isinstance(v, int)}
    with staged_run(args.out) as aside:
        write_truth(result.truth, aside / TRUTH, TRAFFIC_COLUMNS)
        write_run(aside, result.run.updates, result.run.passes, {
            'versions': software_versions(), **config.summary(), 'seed': args.seed,
            'traffic': {k: getattr(args, k) for k in (
                'minutes', 'vehicles', 'fps', 'lanes', 'receding', 'light', 'rig', 'lines')},
            'score': counts, 'timings': stream_timings(result.run.stamps_ns)})
