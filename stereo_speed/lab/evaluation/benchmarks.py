# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Cost of the measurement and its growth: CPU times in comparison with peers.

The candidates take turns, so that other load on the machine affects all alike; medians are
reported.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
import importlib
from io import BytesIO
import statistics
import sys
import time
from types import SimpleNamespace
from typing import Any, Callable, cast, Iterable, Mapping, Sequence

import cv2
import numpy as np

from .tables import Cell, Table
from ...core.compiled import REGISTRY
from ...core.records import Array, InitialFront, StereoPair
from ...core.tracker_config import TrackerConfig
from ...detection import patch_kernels
from ...estimation.particle_filter import weigh
from ...estimation.weights import mean_and_covariance
from ...geometry.camera import Camera
from ...geometry.rig import StereoRig
from ...io.images import grey_from_message
from ...pipeline.assembly import make_pipeline, MeasuringSite
from ...pipeline.config import PipelineConfig
from ...road import line_kernels, reference_kernel
from ...road.line_kernels import Lines, RigViews
from ...road.model import RoadModel, RoadShape
from ...tracking import observation_kernels, photometric_terms
from ...tracking.likelihood import Reference, score
from ...vision.haar import CELLS, PartGrid

Job = Callable[[], object]
PARTICLES, VEHICLES, SCALES = (100, 200, 400, 800), (1, 2, 4, 8), (0.5, 1.0, 1.25, 2.0)
FOLLOWERS = ('MIL', 'CSRT')  # of OpenCV; CSRT is one of its contributed modules
_FRONT_PX = (150, 90)
_OBSERVATIONS, _GRID = 24, (16, 40)  # as for a live reading
_PICKS = 40  # of a line in one view, in the fit of a road
_PAIRS = 10  # pairs of a pass from which the cost of a pair is taken
_REPEATED = 5  # calls of a kernel that are timed together
_STEPS = 50  # steps of a filter without images that are timed together
_TO_GREY = ('bgr8', 'bayer_rggb8')  # peers need the conversion to grey requested


@dataclass(frozen=True)
class Scene:
    """
    A pass that is measured repeatedly.

    :param rig: the cameras.
    :param place: the site.
    :param pairs: the pairs.
    :param fronts: annotated fronts.
    """

    rig: StereoRig
    place: MeasuringSite
    pairs: Sequence[StereoPair]
    fronts: Sequence[InitialFront]


def sgbm(mode: int = cv2.STEREO_SGBM_MODE_SGBM) -> cv2.StereoSGBM:
    """Return the stereo matcher that serves as reference."""
    return cv2.StereoSGBM.create(minDisparity=0, numDisparities=64, blockSize=5, mode=mode)


def milliseconds(job: Job) -> float:
    """Return the CPU time of a call, ms."""
    start = time.process_time()
    job()
    return (time.process_time() - start) * 1e3


def medians(jobs: Mapping[str, Job], rounds: int) -> dict[str, float]:
    """
    Return the median CPU time of each job, ms; the jobs take turns.

    Each job runs once before the timing.
    """
    for job in jobs.values():
        job()
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, job in jobs.items():
            times[name].append(milliseconds(job))
    return {name: statistics.median(values) for name, values in times.items()}


def kernel_table(rounds: int) -> Table:
    """Return the times of kernels, compiled and plain."""
    jobs: dict[str, Job] = {}
    arguments = _arguments()
    for name, args in arguments.items():
        one = REGISTRY[name]
        jobs[f'{name} plain'] = _times(partial(one.plain, *args), _REPEATED)
        jobs[f'{name} compiled'] = _times(partial(one.compiled(), *args), _REPEATED)
    found = medians(jobs, rounds)
    rows: list[list[Cell]] = []
    for name in arguments:
        plain, compiled = (found[f'{name} {kind}'] / _REPEATED for kind in ('plain', 'compiled'))
        rows.append([name.partition('.')[2], plain, compiled, plain / compiled])
    return Table(title='Kernels', columns=('kernel', 'plain numpy, ms', 'compiled, ms', 'ratio'),
                 rows=rows, digits=(0, 3, 3, 1))


def likelihood_table(rounds: int) -> Table:
    """Return the time of a likelihood of both views, and of a ``cv2.warpPerspective`` loop."""
    rng, grid, config = np.random.default_rng(0), PartGrid(10, CELLS), TrackerConfig()
    views = [cv2.GaussianBlur(rng.uniform(0, 255, (960, 1280)).astype(np.float32), (0, 0), 2)
             .astype(np.uint8) for _ in range(2)]
    width, height = _FRONT_PX
    box = np.array([[0, 0], [width, 0], [width, height], [0, height]]) + 500.0
    jobs: dict[str, Job] = {}
    for count in PARTICLES:
        quads = box + rng.normal(0, 2, (count, 1, 2)) + rng.normal(0, 0.5, (count, 4, 2))
        both = quads, quads - [20, 0]
        first = score(views[0], views[1], both, None, grid=grid, config=config)
        reference = Reference(first.left[0], first.right[0])
        jobs[f'ours {count}'] = partial(score, views[0], views[1], both, reference, grid=grid,
                                        config=config)
        jobs[f'warp {count}'] = partial(_warped, views, both, grid)
    found = medians(jobs, rounds)
    return Table(
        title='Likelihood of particles, both views with their correlation',
        columns=('particles', 'ours, ms', 'loop of warpPerspective, sampling only, ms'),
        rows=[[n, found[f'ours {n}'], found[f'warp {n}']] for n in PARTICLES])


def filter_table(rounds: int) -> Table:
    """Return the time of the filter without images, in comparison with filterpy."""
    rng, config = np.random.default_rng(2), TrackerConfig()
    resample: Any = getattr(_installed('filterpy.monte_carlo'), 'systematic_resample', None)
    jobs: dict[str, Job] = {}
    for count in PARTICLES:
        states, scores = rng.standard_normal((count, 4)), rng.normal(0, 3, count)
        jobs[f'ours {count}'] = _times(partial(_filtered, states, scores, config), _STEPS)
        jobs[f'filterpy {count}'] = _times(
            partial(_filtered_by_filterpy, states, scores, resample), _STEPS)
    if resample is None:
        jobs = {name: job for name, job in jobs.items() if name.startswith('ours')}
    found = {name: time_ms / _STEPS for name, time_ms in medians(jobs, rounds).items()}
    return Table(
        title='A step of the filter without images: weights, resampling, mean and covariance',
        columns=('particles', 'ours, ms', 'filterpy, ms'),
        rows=[[n, found[f'ours {n}'], found.get(f'filterpy {n}', 'not installed')]
              for n in PARTICLES], digits=(0, 3, 3))


def vehicle_table(scene: Scene, rounds: int) -> Table:
    """Return the time of a pair over the number of tracks, without detection."""
    jobs = {str(n): _tracked(scene, [scene.fronts[0]] * n) for n in VEHICLES}
    found, pairs = medians(jobs, rounds), min(len(scene.pairs), _PAIRS)
    return Table(title='Tracks in view',
                 columns=('tracks', 'per pair, ms', 'per track and pair, ms'),
                 rows=[[n, found[str(n)] / pairs, found[str(n)] / pairs / n] for n in VEHICLES])


def follower_table(scene: Scene, rounds: int) -> Table:
    """Return the time of a pair with one track, and of trackers of a box in one view."""
    front = scene.fronts[0]
    pairs = scene.pairs[front.frame:front.frame + _PAIRS]
    jobs = {'ours': _tracked(scene, [front])}
    for name in FOLLOWERS:
        make = getattr(cv2, f'Tracker{name}_create', None)
        if make is not None:
            jobs[name] = partial(_followed, make, [pair.left for pair in pairs], front.left_px)
    found = {name: time_ms / len(pairs) for name, time_ms in medians(jobs, rounds).items()}
    return Table(title='Following one vehicle', columns=('tracker', 'output', 'per pair, ms'),
                 rows=[['ours', 'speed, from both views', found['ours']],
                       *([f'OpenCV {name}', 'box in one view', found.get(name, 'not installed')]
                         for name in FOLLOWERS)])


def size_table(scene: Scene, rounds: int) -> Table:
    """Return the time of a pair over the size of the images, and of stereo matching."""
    matchers = {'SGBM': sgbm(), 'SGBM, 3 ways': sgbm(cv2.STEREO_SGBM_MODE_SGBM_3WAY)}
    jobs: dict[str, Job] = {}
    for scale in SCALES:
        scaled = _scaled(scene, scale)
        jobs[f'ours {scale}'] = _found(scaled)
        for name, matcher in matchers.items():
            pair = scaled.pairs[0]
            jobs[f'{name} {scale}'] = partial(matcher.compute, pair.left, pair.right)
    found, pairs = medians(jobs, rounds), min(len(scene.pairs), _PAIRS)
    height, width = scene.pairs[0].left.shape
    return Table(
        title='Size of the images: one vehicle, detected automatically',
        columns=('size', 'per pair, ms', *(f'{name}, ms' for name in matchers)),
        rows=[[f'{round(width * s)}x{round(height * s)}', found[f'ours {s}'] / pairs,
               *(found[f'{name} {s}'] for name in matchers)] for s in SCALES])


def decode_table(scene: Scene, rounds: int) -> Table:
    """
    Return the time to decode an image message to a grey image, in comparison with peers.

    Pillow is used for files only; a format that a peer does not support has a dash.
    """
    image = scene.pairs[0].left
    messages = _image_messages(image)
    theirs, pillow = _installed('rosbags.image'), _installed('PIL.Image')
    jobs: dict[str, Job] = {}
    for name, msg in messages.items():
        jobs[f'ours {name}'] = partial(grey_from_message, msg, 'bench')
        if theirs is not None:
            jobs[f'rosbags {name}'] = partial(theirs.message_to_cvimage, msg,
                                              'mono8' if name in _TO_GREY else None)
        if hasattr(msg, 'format'):
            jobs[f'OpenCV {name}'] = partial(cv2.imdecode, np.frombuffer(msg.data, np.uint8),
                                             cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
            if pillow is not None:
                jobs[f'Pillow {name}'] = partial(_by_pillow, pillow, msg.data)
    found = {name: time_ms / _REPEATED for name, time_ms in medians({
        name: _times(job, _REPEATED) for name, job in jobs.items()}, rounds).items()}

    def cell(peer: str, name: str, installed: bool) -> Cell:
        return found.get(f'{peer} {name}') if installed else 'not installed'
    return Table(
        title=f'Decoding an image of {image.shape[1]}x{image.shape[0]}',
        columns=('format', 'ours, ms', 'OpenCV alone, ms', 'rosbags-image, ms', 'Pillow, ms'),
        rows=[[name, found[f'ours {name}'], cell('OpenCV', name, True),
               cell('rosbags', name, theirs is not None), cell('Pillow', name, pillow is not None)]
              for name in messages])


def _image_messages(grey: Array) -> dict[str, SimpleNamespace]:
    """Return messages with an image (H, W) uint8 by format, compressed ones first."""
    height, width = grey.shape
    found = {f'{kind}, 8 bits': SimpleNamespace(
        format=f'mono8; {kind} compressed', data=cv2.imencode(f'.{kind}', grey)[1].tobytes())
        for kind in ('jpeg', 'png')}
    deep = grey.astype(np.uint16) * 257
    found['png, 16 bits'] = SimpleNamespace(
        format='mono16; png compressed', data=cv2.imencode('.png', deep)[1].tobytes())
    for encoding, pixels in (('mono8', grey), ('mono16', deep), ('bayer_rggb8', grey),
                             ('bgr8', cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))):
        found[encoding] = SimpleNamespace(
            encoding=encoding, height=height, width=width, step=pixels.strides[0],
            is_bigendian=int(sys.byteorder == 'big'), data=pixels.tobytes())
    return found


def _by_pillow(pillow: Any, data: bytes) -> object:
    """Decode a file to an array of its grey values."""
    return np.asarray(pillow.open(BytesIO(data)))


def _installed(module: str) -> Any:
    """Return a module of a peer; None where it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        return None


def _times(job: Job, count: int) -> Job:
    def several() -> None:
        for _ in range(count):
            job()
    return several


def _arguments() -> dict[str, tuple[Any, ...]]:
    """Return the arguments of kernels for a live reading and the fit of a road, by name."""
    rng, n, samples = np.random.default_rng(1), _OBSERVATIONS, _GRID[0] * _GRID[1]
    texture = rng.standard_normal(samples)
    patches = texture + 0.2 * rng.standard_normal((n, 2, samples))
    patches = (patches - patches.mean(-1, keepdims=True)) / patches.std(-1, keepdims=True)
    jacobian, by_relief = (rng.standard_normal(shape) for shape in (
        (n, 2, 3, samples), (n, 2, samples)))
    relief, outlines = 0.02 * rng.standard_normal((n, samples)), np.zeros((n, 2, samples))
    crop = cv2.GaussianBlur(rng.uniform(0, 255, (90, 160)).astype(np.float32), (0, 0), 1.2)
    v, u = (a.ravel() for a in np.meshgrid(
        np.linspace(4, 85, _GRID[0]), np.linspace(4, 155, _GRID[1]), indexing='ij'))
    wide = rng.uniform(0, 255, (3, 18, 113)).astype(np.float32)
    window = np.ascontiguousarray(wide[:, :9, 14:99])
    mask, none = np.ones((3, 85), bool), np.zeros((0, 0), np.float32)
    terms, seen, found = (m.__name__ for m in (
        photometric_terms, observation_kernels, patch_kernels))
    return {
        f'{terms}._temporal': (np.arange(n), patches, jacobian, by_relief, outlines,
                               np.zeros_like(outlines), rng.standard_normal(samples), relief,
                               rng.uniform(100, samples, n), rng.uniform(5, 20, n), 3.0, 0.3,
                               0.02, 1.0),
        f'{terms}._cross': (patches[0], jacobian[0, 0], by_relief[0, 0], outlines[0], relief[0],
                            400.0, 3.0, 0.3),
        f'{seen}.views': (crop, none, crop, none, np.zeros((2, 2)), np.array([[u, v], [u, v]]),
                          100 * rng.standard_normal((2, 6, samples, 2)), np.full((2, 2), 4.0),
                          2.2, 10.0),
        f'{found}.shifted': (wide[:, :9].copy(), wide[:, 9:].copy(), np.full(3, 14), mask, 4),
        f'{found}.mirrored': (np.ascontiguousarray(wide), 85),
        f'{found}.edges': (window, window + 1),
        **_road_arguments(),
    }


def _road_arguments() -> dict[str, tuple[Any, ...]]:
    """Return the arguments of the kernels of a road's fit: a bend with three lines, by name."""
    frame = np.array([[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]])  # straight towards the camera
    model = RoadModel(frame, np.array([0, 4.0, 40.0]), 30.0, 3, RoadShape(2, 2, 1))
    steps = 1e-6 * np.eye(model.size, dtype=np.float64)
    roads = np.vstack([np.zeros(model.size), steps, -steps])
    roads[:, model.places.offsets] += -2.0, 1.5, 5.0
    roads[:, model.places.curvature.start] += 0.3
    one, many = (Lines.of(model, x, model.reference(x)) for x in (roads[:1], roads))
    views = cast(RigViews, RigViews.of(_rig()))  # kernels know its lenses
    group = np.arange(6 * _PICKS) // _PICKS  # line by line, left and right
    picks = group // 2, group % 2 == 1
    s_m = np.tile(np.linspace(-25.0, 25.0, _PICKS), 6)
    uv_px = line_kernels.pixels_of_lines(*picks, s_m, *one, *views)[0] + 2.0
    between = np.repeat(np.linspace(-1, 1, 2 * len(model.s_m) - 1)[None], len(roads), axis=0)
    name = line_kernels.__name__
    return {
        f'{name}.feet_on_lines': (*picks, uv_px, *one, *views),
        f'{name}.pixels_of_lines': (
            *picks, s_m, *many, *views.drifted(np.repeat(np.eye(3)[None], len(roads), axis=0))),
        f'{reference_kernel.__name__}.along': (
            *(0.3 * np.sin(between + k) for k in range(3)),
            np.repeat(frame[None], len(roads), axis=0),
            np.ascontiguousarray(many.points_m[:, 0]), many.step_m),
    }


def _rig() -> StereoRig:
    """Return two equal cameras side by side, with distortion."""
    K = np.array([[1000.0, 0, 640.0], [0, 1000.0, 480.0], [0, 0, 1]])
    D = np.array([-0.28, 0.09, 1e-3, -5e-4, 0.01])
    left, right = (Camera(side, 1280, 960, K, D, 'plumb_bob') for side in ('left', 'right'))
    return StereoRig(left, right, np.eye(3), np.array([-0.5, 0.0, 0.0]))


def _filtered(states: Array, scores: Array, config: TrackerConfig) -> object:
    weighed = weigh(np.zeros(len(states)), scores, config.resample_ess, np.random.default_rng(3))
    survivors = states[weighed.ancestors]
    return mean_and_covariance(np.exp(weighed.log_weights), survivors)


def _filtered_by_filterpy(states: Array, scores: Array, resample: Callable[..., Any]) -> object:
    """Do the same as in filterpy's book, with its resampling."""
    weights = np.exp(scores - scores.max())
    weights /= weights.sum()
    survivors = states[resample(weights)]
    return survivors.mean(axis=0), np.cov(survivors, rowvar=False)


def _warped(views: Sequence[Any], quads: Iterable[Any], grid: PartGrid) -> None:
    rows, columns = grid.shape
    to = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], np.float32)
    for view, corners in zip(views, quads):
        for quad in corners.astype(np.float32):
            cv2.warpPerspective(view, cv2.getPerspectiveTransform(quad, to), (columns, rows))


def _tracked(scene: Scene, fronts: Sequence[InitialFront]) -> Job:
    def once() -> None:
        config = PipelineConfig(TrackerConfig())
        pipeline = scene.place.pipeline(config, fronts)
        for pair in scene.pairs[:_PAIRS]:
            pipeline.process(pair)
    return once


def _followed(make: Callable[[], Any], images: Sequence[Any], front_px: Array) -> None:
    """Track the box of a front; OpenCV's trackers need three channels."""
    first, *later = (cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) for image in images)
    low, high = front_px.min(axis=0), front_px.max(axis=0)
    tracker = make()
    tracker.init(first, tuple(int(v) for v in np.round([*low, *(high - low)])))
    for image in later:
        tracker.update(image)


def _found(scene: Scene) -> Job:
    pipeline = make_pipeline(scene.rig, scene.place.lanes, PipelineConfig(TrackerConfig()))

    def once() -> None:
        pipeline.reset()
        for pair in scene.pairs[:_PAIRS]:
            pipeline.process(pair)
    return once


def _scaled(scene: Scene, scale: float) -> Scene:
    """Return a scene as seen by cameras of another resolution."""
    pairs = [replace(pair, **{side: cv2.resize(
        getattr(pair, side), None, fx=scale, fy=scale,
        interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
        for side in ('left', 'right')}) for pair in scene.pairs[:_PAIRS]]
    height, width = pairs[0].left.shape
    grown = np.diag([scale, scale, 1.0])
    centre = np.array([[0, 0, 0.5 * (scale - 1)], [0, 0, 0.5 * (scale - 1)], [0, 0, 0]])
    cameras = [replace(camera, width_px=width, height_px=height, K=grown @ camera.K + centre)
               for camera in (scene.place.rig.left, scene.place.rig.right)]
    rig = replace(scene.place.rig, left=cameras[0], right=cameras[1])
    return replace(scene, rig=rig, pairs=pairs)
