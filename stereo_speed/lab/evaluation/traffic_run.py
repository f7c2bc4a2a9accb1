# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Run simulated traffic through the pipeline: the site, the run and its files."""
from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Iterable, Iterator, Mapping, Optional

import numpy as np
from tqdm import tqdm

from .labeled_sequence import LineKnowledge, read_back
from .traffic import Row, score_traffic, TrafficRules, TrafficScore
from ..sim.sequence import exact_site
from ..sim.traffic import TrafficPair, TrafficStream
from ..sim.traffic_config import TrafficConfig
from ..sim.truth import TRAFFIC_COLUMNS, write_truth
from ...core.records import StereoPair
from ...io.results import software_versions, staged_run, stream_timings, write_run
from ...pipeline.assembly import MeasuringSite
from ...pipeline.pipeline import SpeedPipeline
from ...pipeline.run import Run, run as run_pipeline
from ...site.file import load_site

TRUTH = 'truth.csv'
REFINE_PAIRS, REFINE_FPS = 40, 1.0  # traffic for refining a site


@dataclass(frozen=True, eq=False)
class TrafficRun:
    """
    The run of a stream with its truth.

    :param run: the run.
    :param truth: rows of ``truth.csv``.
    :param lanes: names of the lanes, the rightmost first.
    """

    run: Run
    truth: list[Row]
    lanes: tuple[str, ...]

    @property
    def pair_ms(self) -> float:
        """Return the processor time of the pipeline per pair, ms."""
        return 1e3 * self.run.cpu_s / max(len(self.run.stamps_ns), 1)

    def score(self, rules: TrafficRules = TrafficRules()) -> TrafficScore:
        """Score the run against its truth."""
        return score_traffic(self.truth, self.run.updates, self.run.passes, self.lanes, rules)


def stream_of(config: TrafficConfig, seed: int) -> TrafficStream:
    """Return the stream of a configuration and seed."""
    return TrafficStream(config, np.random.default_rng(seed))


def traffic_site(config: TrafficConfig, seed: int, lines: LineKnowledge) -> MeasuringSite:
    """
    Return the site as if read from a user's site file.

    :param config: the traffic.
    :param seed: seed of the stream.
    :param lines: source of the lines; refined ones use a few pairs of other traffic.
    """
    stream = stream_of(config, seed)
    content = exact_site(stream.scene) if lines is LineKnowledge.EXACT else stream.site
    minutes = REFINE_PAIRS / REFINE_FPS / 60
    early = replace(
        config, scene=replace(config.scene, fps=REFINE_FPS, drop=(), gaps_s=()), minutes=minutes,
        vehicles=max(round(config.vehicles * minutes / config.minutes), 1))
    pairs = (one.pair for one in stream_of(early, seed))
    return MeasuringSite.of(read_back(content, load_site), stream.rig,
                            pairs if lines is LineKnowledge.REFINED else None)


def measure_traffic(stream: Iterable[TrafficPair], pipeline: SpeedPipeline,
                    total: Optional[int] = None) -> TrafficRun:
    """
    Run a stream through a pipeline.

    :param stream: the pairs with their truth.
    :param pipeline: a new pipeline.
    :param total: expected number of pairs, for the progress bar.
    """
    truth: list[Row] = []

    def pairs() -> Iterator[StereoPair]:
        for one in tqdm(stream, total=total, desc='traffic', unit='pair', disable=None):
            truth.extend(one.truth)
            yield one.pair
    return TrafficRun(run_pipeline(pipeline, pairs()), truth, tuple(pipeline.lanes))


def write_traffic(out: Path, result: TrafficRun, score: TrafficScore,
                  facts: Mapping[str, Any]) -> None:
    """
    Write the truth and the files of a run, all or none.

    :param out: folder, made where it is missing.
    :param facts: content of ``summary.json`` beside versions, counts and timings.
    """
    counts = {k: v for k, v in asdict(score).items() if isinstance(v, int)}
    with staged_run(out) as aside:
        write_truth(result.truth, aside / TRUTH, TRAFFIC_COLUMNS)
        write_run(aside, result.run.updates, result.run.passes, {
            'versions': software_versions(), **facts, 'score': counts,
            'timings': stream_timings(result.run.stamps_ns)})
