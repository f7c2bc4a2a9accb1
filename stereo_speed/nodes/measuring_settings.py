# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Declares and checks the parameters of the measuring nodes."""
from __future__ import annotations

from dataclasses import dataclass

from rclpy.node import Node

from .common import Parameters
from ..core.config import ConfigRecord
from ..core.tracker_config import TrackerConfig
from ..pipeline.config import PipelineConfig, SiteConfig
from ..pipeline.registry import DETECTORS, TRACKERS

MOST_REFINE_PAIRS = 200


@dataclass(frozen=True)
class MeasuringSettings:
    """
    The parameters of a measuring node; ``declare`` describes each of them.

    :param config: parameters of the pipeline, including the chosen tracker and detector.
    :param unused: prefixes of the parameters of trackers and detectors that were not chosen.
    """

    site_path: str
    init_path: str
    seed: int
    refine_pairs: int
    detector_process: bool
    pass_process: bool
    silence_s: float
    most_wait_s: float
    hurry: bool
    config: PipelineConfig
    unused: tuple[str, ...]
    calibration_months: float

    @classmethod
    def declare(cls, node: Node, p: Parameters) -> MeasuringSettings:
        """
        Declare the parameters, and return their values.

        :raises InputError: an unknown name, a value out of bounds.
        """
        site_path = p.get('site', '', 'path of the site file')
        init_path = p.get('init', '', 'path of an init file that marks the vehicles; '
                          'without it they are found automatically')
        seed = p.get('seed', 0, 'seed of all randomness', 0, 2 ** 31 - 1)
        tracker = p.get('tracker', 'constrained', 'tracker: ' + ', '.join(TRACKERS.names))
        detector = p.get('detector', 'plane_sweep',
                         'detector that finds the vehicles: ' + ', '.join(DETECTORS.names))
        return cls(
            site_path, init_path, seed,
            refine_pairs=p.get(
                'refine_site_pairs', 0, 'number of first pairs by whose images the site is '
                'refined, which takes seconds; 0 to use the site as it is', 0, MOST_REFINE_PAIRS),
            detector_process=p.get(
                'detector_process', True, 'search for vehicles in a process of its own, while '
                'the tracks of the same pair are updated; results are the same, and a second '
                'core is used; for the detector plane_sweep only'),
            pass_process=p.get(
                'pass_process', True, 'measure finished passes in a process of its own, beside '
                'the pairs that follow; results are the same'),
            silence_s=p.get(
                'silence_s', 2.0, 'all passes end when no pair has arrived for this time [s] and '
                'for five times the last interval between pairs', 0.1, 3600.0),
            most_wait_s=p.get(
                'most_wait_s', 2.0, 'when a pair has waited longer [s], the newest pair is '
                'measured and older ones are skipped', 0.0, 3600.0),
            hurry=p.get(
                'hurry', True, 'above 16 pairs a second, readings do not wait for solutions, and '
                'a pair that has waited for most of the interval between two is hurried: vehicles '
                'are solved for less often, with a larger 1-sigma; false leaves skipping pairs as '
                'the only remedy'),
            config=_config(p, tracker, detector, f'{node.get_name()}: parameter'),
            unused=tuple(
                f'{registry.kind}s.{name}.' for registry in (TRACKERS, DETECTORS)
                for name in registry.names if name not in (tracker, detector)),
            calibration_months=p.get(
                'calibration_months', 12.0, 'greatest age of a calibration that is measured with, '
                'by the date in the site file; in the last month there is a warning', 0.1, 1200.0))


def _config(p: Parameters, tracker: str, detector: str, where: str) -> PipelineConfig:
    """
    Return the parameters, including those of the chosen tracker and detector.

    :raises InputError: an unknown name, a value out of bounds.
    """
    settings: dict[str, dict[str, ConfigRecord]] = {}
    for registry, name in ((TRACKERS, tracker), (DETECTORS, detector)):
        registry.check(name, where)
        kind = type(registry.settings(name, {}, where))
        settings[registry.kind] = {name: p.config(kind, f'{registry.kind}s.{name}.')}
    return PipelineConfig(
        p.config(TrackerConfig), tracker, detector, trackers=settings['tracker'],
        detectors=settings['detector'], site=p.config(SiteConfig))
