# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Sequences with truth, simulated or from bags, and runs of trackers over them."""
from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
import tempfile
from typing import Callable, Mapping, Optional, Sequence, TypeVar

import numpy as np
import yaml

from .scorer import beside_truth, SequenceRun
from ..sim.calibration_error import drawn_calibration
from ..sim.config import SimConfig
from ..sim.sequence import SimSequence, simulate
from ...core.records import InitialFront, StereoPair
from ...core.tracker_config import TrackerConfig
from ...io.bags import StereoBag
from ...io.truth import read_truth, truth_of_rows, VehicleTruth
from ...pipeline.assembly import MeasuringSite
from ...pipeline.config import PipelineConfig, SiteConfig
from ...pipeline.run import run as run_pipeline
from ...site.file import load_site
from ...site.init_file import load_init
from ...steadying.config import SteadyingConfig

Content = TypeVar('Content')


class LineKnowledge(str, Enum):
    """Source of the lines of a simulated site."""

    PICKED = 'picked'  # clicked
    REFINED = 'refined'  # clicked, then refined by images
    EXACT = 'exact'


@dataclass(frozen=True, eq=False, kw_only=True)
class LabeledSequence:
    """
    A sequence with everything a tracker needs, and its truth.

    :param site: rig, lanes and tolerances.
    :param annotations: annotated fronts; None has them detected.
    :param pairs: the pairs.
    :param truths: truth of each vehicle.
    """

    site: MeasuringSite
    annotations: Optional[tuple[InitialFront, ...]]
    pairs: Sequence[StereoPair]
    truths: tuple[VehicleTruth, ...]


def simulated_sequence(config: SimConfig, seed: Sequence[int], lines: LineKnowledge, *,
                       tolerances: Optional[TrackerConfig] = None) -> LabeledSequence:
    """
    Simulate a sequence and reconstruct its lanes.

    :param config: configuration of the simulation.
    :param seed: seed of the simulation.
    :param lines: source of the lanes' lines; refined ones use the sequence's own images, as one
        would before measuring.
    :param tolerances: draw errors of calibration and stamps within the tolerances of these
        parameters; None leaves both exact.
    :raises InputError: the scene cannot be simulated.
    """
    sequence = simulate(config, np.random.default_rng(list(seed)))
    if tolerances is not None:
        sequence = disturbed(sequence, tolerances, np.random.default_rng([*seed, 1]))
    content = sequence.site_exact if lines is LineKnowledge.EXACT else sequence.site
    site = MeasuringSite.of(read_back(content, load_site), sequence.rig,
                            sequence.pairs if lines is LineKnowledge.REFINED else None,
                            rest_by=(lambda: sequence.pairs) if config.sway_deg else None)
    return LabeledSequence(site=site, annotations=read_back(sequence.init, load_init),
                           pairs=sequence.pairs, truths=truth_of_rows(sequence.truth))


def disturbed(sequence: SimSequence, tolerances: TrackerConfig,
              rng: np.random.Generator) -> SimSequence:
    """
    Disturb the calibration and the stamps that a tracker gets, within its tolerances.

    The stamps of both views have the same error, as from one trigger.

    :param tolerances: has the 1-sigmas ``focal_std``, ``baseline_std_m`` and ``stamp_std_s``.
    """
    rig = drawn_calibration(sequence.rig, tolerances, rng)
    late_ns = {pair.stamp_ns: round(1e9 * tolerances.stamp_std_s * rng.standard_normal())
               for pair in sequence.pairs}
    return replace(
        sequence, rig=rig,
        pairs=tuple(replace(p, stamp_ns=p.stamp_ns + late_ns[p.stamp_ns],
                            right_stamp_ns=p.right_stamp_ns + late_ns[p.stamp_ns])
                    for p in sequence.pairs),
        truth=tuple({**row, 'stamp_ns': row['stamp_ns'] + late_ns[row['stamp_ns']]}
                    for row in sequence.truth))


def read_back(content: Mapping[str, object], load: Callable[[Path], Content]) -> Content:
    """
    Write content to a YAML file and read it back, as if it were a user's file.

    :param load: reads the file.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'content.yaml'
        path.write_text(yaml.safe_dump(dict(content)), encoding='utf-8')
        return load(path)


def bag_sequence(bag: Path, site: Path, init: Optional[Path], truth: Path, *,
                 left: Optional[str] = None, right: Optional[str] = None) -> LabeledSequence:
    """
    Read a sequence from a bag, with its site, annotations and truth.

    :raises InputError: a file is unusable.
    """
    truths, read = read_truth(truth), load_site(site)
    annotations = None if init is None else load_init(init)
    with StereoBag(bag, left=left, right=right) as opened:
        return LabeledSequence(
            site=MeasuringSite.of(read, opened.rig, rest_by=opened.pairs),
            annotations=annotations, pairs=tuple(opened.pairs()), truths=truths)


def run_tracker(sequence: LabeledSequence, tracker: str, config: TrackerConfig,
                seed: int, *, steadying: bool = False) -> SequenceRun:
    """
    Run a tracker over a sequence like ``replay``, and compare its reports with the truth.

    :param tracker: name of the tracker.
    :param config: its parameters.
    :param seed: seed of all its randomness.
    :param steadying: whether the rotation of the cameras is estimated in each pair.
    """
    site = SiteConfig(steadying=SteadyingConfig(enabled=steadying))
    pipeline = sequence.site.pipeline(PipelineConfig(config, tracker, site=site),
                                      sequence.annotations, seed=seed)
    done = run_pipeline(pipeline, sequence.pairs)
    return SequenceRun(vehicles=beside_truth(done.updates, done.passes, sequence.truths),
                       cpu_ms=round(1e3 * done.cpu_s / len(sequence.pairs), 3))
