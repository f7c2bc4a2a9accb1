# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The monocular tracker against ground truth: with the environment and without.

overlap 0.
A target is kept to the end if the overlap of its box with the true one, intersection over union,
is above 0.25 in the last used frame of the truth. A frame without a box has overlap 0.
overlap 0.
"""
from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import lru_cache
import hashlib
from pathlib import Path
from typing import Any, Mapping, Optional, Sequence

import numpy as np

from .tables import Cell, Table
from ...batch.job import Job, Result
from ...core.errors import InputError
from ...core.records import Array
from ...io.mot import load_truth
from ...io.recording import hash_files
from ...io.scene_map import check_map_size, load_map
from ...io.targets_file import load_targets
from ...io.video import read_frames
from ...monocular.boxes import overlap, Target, TargetEstimate
from ...monocular.config import MonocularConfig
from ...monocular.distance import DistanceField
from ...monocular.tracker import MonocularTracker

KEPT_OVERLAP = 0.25  # overlap above which a box is on its target


@dataclass(frozen=True, kw_only=True)
class Setting:
    """
    A tracker with its settings in the comparison.

    :param tracker: ``environment`` or ``plain``.
    :param particles: number of particles.
    :param stride: every stride-th frame is used.
    """

    tracker: str
    particles: int
    stride: int

    @property
    def label(self) -> str:
        """Return the name of the tracker with its number of particles."""
        return f'{self.tracker}, {self.particles} particles'


@dataclass(frozen=True, kw_only=True)
class TargetScore:
    """
    One target in one run.

    :param kept: whether it was kept to the end.
    :param overlap: mean overlap over the frames of the truth.
    :param followed: share of these frames with an overlap above 0.25.
    :param astray: share of these frames with a box elsewhere.
    """

    kept: bool
    overlap: float
    followed: float
    astray: float


@dataclass(frozen=True, kw_only=True)
class VideoScene:
    """
    The files of a video.

    :param video: video file, folder of images, or bag.
    :param map: map of the scene.
    :param init: targets file.
    :param truth: boxes in the MOTChallenge's format.
    """

    video: str
    map: str  # noqa: A003
    init: str
    truth: str


def score_target(target: Target, estimates: Mapping[int, TargetEstimate],
                 truth: Mapping[int, Array], stride: int,
                 last_frame: int) -> Optional[TargetScore]:
    """
    Score a target's boxes against the truth.

    :param estimates: estimates by frame.
    :param truth: true boxes by frame.
    :param stride: only every stride-th frame after the marked one counts.
    :param last_frame: last frame of the video.
    :return: the score; None when the truth has no frame after the marked one.
    """
    frames = [f for f in sorted(truth) if target.frame < f <= last_frame
              and (f - target.frame) % stride == 0]
    if not frames:
        return None
    overlaps = np.array([float(overlap(estimates[f].envelope_px, truth[f]))
                         if f in estimates else 0.0 for f in frames])
    there = np.array([f in estimates for f in frames])
    good = overlaps > KEPT_OVERLAP
    return TargetScore(kept=bool(good[-1]), overlap=float(overlaps.mean()),
                       followed=float(good.mean()), astray=float(np.mean(there & ~good)))


def plan_jobs(scene: VideoScene, settings: Sequence[Setting], seeds: int,
              config: MonocularConfig) -> list[Job]:
    """
    Return a job per seed, which runs all settings over the video and reads it once.

    :param config: parameters of the tracker; the settings override them.
    :raises InputError: a file is unusable.
    """
    load_inputs(scene)
    files = hashlib.sha256(b''.join(Path(p).read_bytes() for p in (
        scene.map, scene.init, scene.truth))).hexdigest()
    common = {'scene': asdict(scene), 'settings': [asdict(s) for s in settings],
              'config': asdict(config), 'input': [hash_files(Path(scene.video)), files]}
    name = Path(scene.video).name
    return [Job(key=f'{name}, seed {seed}', parameters={**common, 'seed': seed}, group=f'{seed}')
            for seed in range(seeds)]


def load_inputs(scene: VideoScene) -> tuple[list[Target], dict[int, dict[int, Array]]]:
    """
    Read targets and truth.

    :raises InputError: a file is unusable, or a target has no truth.
    """
    load_map(scene.map)
    targets, truth = load_targets(scene.init), load_truth(scene.truth)
    for target in targets:
        if target.id not in truth:
            raise InputError(scene.truth, f'boxes of target {target.id}', 'none',
                             'boxes of every target')
    return targets, truth


def run_scene(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """
    Run all settings over a video with one seed; the work of a job.

    :return: scores by target, by the number of the setting.
    """
    scene = VideoScene(**parameters['scene'])
    targets, truth = load_inputs(scene)
    settings = [Setting(**s) for s in parameters['settings']]
    field = _field(scene.map)
    config = MonocularConfig(**parameters['config'])
    trackers = [MonocularTracker(
        field, targets, replace(config, particles=s.particles), tracker=s.tracker,
        seed=parameters['seed'], stride=s.stride) for s in settings]
    found: list[dict[tuple[int, int], TargetEstimate]] = [{} for _ in settings]
    last_true = {number: max(boxes) for number, boxes in truth.items()}
    last = 0
    for frame in read_frames(scene.video):
        check_map_size(field.labels, frame.image, scene.map)
        last = frame.number
        for tracker, estimates in zip(trackers, found):
            for e in tracker.process(frame.number, frame.image):
                estimates[e.id, e.frame] = e
            for number in [i for i in tracker.filters if frame.number >= last_true[i]]:
                tracker.stop(number)  # later boxes have no truth
    out: dict[str, Any] = {}
    for index, (setting, estimates) in enumerate(zip(settings, found)):
        scores = {t.id: score_target(t, {f: e for (i, f), e in estimates.items() if i == t.id},
                                     truth[t.id], setting.stride, last) for t in targets}
        out[str(index)] = {str(i): asdict(s) for i, s in scores.items() if s is not None}
    return out


@lru_cache(maxsize=4)
def _field(path: str) -> DistanceField:
    """Return the distance field of a map, computed once per process."""
    return DistanceField(load_map(path))


def scores_of(results: Sequence[Result], setting: int) -> dict[int, list[TargetScore]]:
    """Return the scores of a setting by target, over the seeds."""
    gathered: dict[int, list[TargetScore]] = {}
    for result in results:
        for number, score in ((result.value or {}).get(str(setting)) or {}).items():
            gathered.setdefault(int(number), []).append(TargetScore(**score))
    return gathered


def survival_rate(scores: Mapping[int, Sequence[TargetScore]]) -> tuple[float, float]:
    """Return the share of targets kept to the end, and its standard error over the seeds."""
    if not scores:
        return float('nan'), float('nan')
    runs = np.array([[s.kept for s in rows] for rows in scores.values()], dtype=float)
    by_seed = runs.mean(axis=0)
    error = by_seed.std(ddof=1) / np.sqrt(len(by_seed)) if len(by_seed) > 1 else float('nan')
    return float(by_seed.mean()), float(error)


def summary_table(title: str, settings: Sequence[Setting], results: Sequence[Result]) -> Table:
    """Return a table of the settings: kept targets, and quality of tracking."""
    rows: list[list[Cell]] = []
    for index, setting in enumerate(settings):
        scores = scores_of(results, index)
        flat = [s for values in scores.values() for s in values]
        share, error = survival_rate(scores)
        means = [float(np.mean([getattr(s, name) for s in flat])) if flat else float('nan')
                 for name in ('followed', 'astray', 'overlap')]
        rows.append([setting.tracker, setting.particles, setting.stride, 100 * share,
                     100 * error, 100 * means[0], 100 * means[1], means[2]])
    done = sum(r.value is not None for r in results)
    return Table(title=title, columns=(
        'tracker', 'particles', 'stride', 'kept to the end, %', 's.e., %', 'frames followed, %',
        'frames astray, %', 'mean overlap'), rows=rows, digits=(0, 0, 0, 1, 1, 1, 1, 3),
        note=f'{done} seeds; kept: overlap above {KEPT_OVERLAP} in the last frame; astray: boxes '
             'with a smaller overlap')


def target_table(title: str, settings: Sequence[Setting], results: Sequence[Result]) -> Table:
    """Return a table of the targets: share of the runs that kept each, and overlap."""
    scores = [scores_of(results, index) for index in range(len(settings))]
    numbers = sorted({i for s in scores for i in s})
    rows = []
    for number in numbers:
        cells: list[Cell] = [number]
        for found in scores:
            values = found.get(number, [])
            cells += [100 * float(np.mean([v.kept for v in values])) if values else None,
                      float(np.mean([v.overlap for v in values])) if values else None]
        rows.append(cells)
    columns = ['target'] + [c for s in settings for c in (
        f'{s.label}, stride {s.stride}: kept, %', 'overlap')]
    return Table(title=title, columns=columns, rows=rows,
                 digits=[0] + [0, 2] * len(settings))
