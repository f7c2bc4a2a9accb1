# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``track-environment``: follow marked targets through the video of one camera.

The same video, map, targets and seed give the same files, byte for byte.
"""
from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
import sys
import tempfile
from typing import Any, Optional

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from .options import number_in
from ..core.config import load_config
from ..core.errors import InputError
from ..io.atomic import prepare_folder
from ..io.recording import hash_files
from ..io.results import file_sha256, software_versions
from ..io.scene_map import check_map_size, load_map
from ..io.target_results import ANNOTATED, SUMMARY, write_targets
from ..io.targets_file import check_targets, load_targets
from ..io.video import frames_missing, read_frames
from ..io.video_writer import VideoWriter
from ..monocular.boxes import Target, TargetEnd, TargetEstimate
from ..monocular.config import MonocularConfig
from ..monocular.distance import DistanceField
from ..monocular.tracker import MonocularTracker, TRACKERS
from ..report.targets import draw_targets


@dataclass
class VideoRun:
    """
    The results of a run over a video.

    :param estimates: boxes, in the order of the frames.
    :param ends: how the targets ended.
    :param frames: number of frames of the video.
    :param missing: number of further frames that the file states but does not have.
    """

    estimates: list[TargetEstimate] = field(default_factory=list)
    ends: list[TargetEnd] = field(default_factory=list)
    frames: int = 0
    missing: int = 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``track-environment``."""
    add = parser.add_argument
    add('video', metavar='VIDEO', type=Path, help='video file, folder of images, or bag')
    add('--map', required=True, type=Path, metavar='PNG',
        help='map: 255 pathway, 128 accessible, 0 inaccessible')
    add('--init', required=True, type=Path, metavar='YAML', help='targets file')
    add('--out', required=True, type=Path, metavar='DIR', help='folder to write')
    add('--tracker', choices=TRACKERS, default='environment',
        help='tracker that uses the environment (default), or the plain particle filter')
    add('--particles', type=int, metavar='N', help='number of particles (default: 150)')
    add('--seed', type=number_in(int, 0, 2 ** 63 - 1), default=0, metavar='S',
        help='seed (default: 0)')
    add('--stride', type=number_in(int, 1, 10 ** 6), default=1, metavar='K',
        help='use every K-th frame, counted from the frame of each mark (default: 1)')
    add('--likelihood', choices=('default', 'paper'), default='default',
        help='paper: one histogram of the marked box, without our extensions')
    add('--config', type=Path, metavar='YAML', help='parameters of the tracker')
    add('--topic', metavar='TOPIC', help='image topic of a bag with several')
    add('--annotate', action='store_true', help=f'also write {ANNOTATED}')


def run(args: argparse.Namespace) -> int:
    """Track, write all files, and print how the targets ended."""
    config = make_config(args)
    targets = load_targets(args.init)
    labels = load_map(args.map)
    check_targets(targets, labels.shape[1], labels.shape[0], args.init)
    folder = prepare_folder(args.out)
    (folder / SUMMARY).unlink(missing_ok=True)
    with tempfile.TemporaryDirectory(prefix='.partial-', dir=folder) as aside:
        annotated = Path(aside) / ANNOTATED if args.annotate else None
        result = track(args, config, targets, labels, annotated)
        write_targets(folder, result.estimates, result.ends, summary(args, config, result),
                      annotated)
    if result.missing:
        print(f'warning: {args.video}: breaks off after {result.frames} frames; its header '
              f'states {result.frames + result.missing}', file=sys.stderr)
    for end in sorted(result.ends, key=lambda e: e.id):
        print(f'target {end.id}: {end.state.value}, frames {end.first_frame} to '
              f'{end.last_frame} ({end.frames} boxes)')
    print(f'results in {args.out}')
    return 0


def make_config(args: argparse.Namespace) -> MonocularConfig:
    """
    Return the parameters of the file, overridden by the other options.

    :raises InputError: a value out of bounds.
    """
    config = load_config(args.config, MonocularConfig)
    if args.likelihood == 'paper':
        config = config.with_paper_likelihood()
    if args.particles is None:
        return config
    try:
        return replace(config, particles=args.particles)
    except InputError as error:
        raise InputError('track-environment', '--particles', error.found, error.wanted) from None


def track(args: argparse.Namespace, config: MonocularConfig, targets: list[Target],
          labels: NDArray[np.uint8], annotated: Optional[Path]) -> VideoRun:
    """
    Run the tracker over the video.

    :param annotated: annotated video to write; None for none.
    :raises InputError: frames of another size than the map, or a target marked in a frame that
        the video does not have.
    """
    tracker = MonocularTracker(DistanceField(labels), targets, config, tracker=args.tracker,
                               seed=args.seed, stride=args.stride)
    result, video = VideoRun(), None
    try:
        for frame in tqdm(read_frames(args.video, args.topic), desc='track', unit='frame',
                          disable=None):
            check_map_size(labels, frame.image, args.map)
            found = tracker.process(frame.number, frame.image)
            result.estimates += found
            result.ends += tracker.ended()
            result.frames = frame.number
            if annotated is not None:
                video = video or VideoWriter(annotated, frame.image.shape)
                video.write(draw_targets(frame.image, found, labels))
        _check_frames(targets, result.frames, args.init)
        result.ends += tracker.finish()
        result.missing = frames_missing(args.video, result.frames)
        if video is not None:
            video.keep()
    finally:
        if video is not None:
            video.close()
    return result


def _check_frames(targets: list[Target], frames: int, where: object) -> None:
    """Refuse a target marked in a frame that the video does not have."""
    for index, target in enumerate(targets):
        if target.frame > frames:
            raise InputError(where, f'targets[{index}].frame', target.frame,
                             f'at most {frames}, the number of frames')


def summary(args: argparse.Namespace, config: MonocularConfig,
            result: VideoRun) -> dict[str, Any]:
    """Return the content of ``summary.json``, which is the same for a repeated run."""
    ends: dict[str, int] = {}
    for end in result.ends:
        ends[end.state.value] = ends.get(end.state.value, 0) + 1
    return {'versions': software_versions(), 'tracker': args.tracker, 'seed': args.seed,
            'stride': args.stride, 'parameters': asdict(config), 'frames': result.frames,
            'frames_missing': result.missing, 'ends': ends,
            'input_sha256': hash_files(args.video), 'map_sha256': file_sha256(args.map),
            'init_sha256': file_sha256(args.init)}
