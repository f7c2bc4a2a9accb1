# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Which tracker and detector measure, and all their parameters.

In a parameters file those that all trackers share stand at the top; those of one tracker or
detector alone stand under its name, in ``trackers`` or ``detectors``; those of the road and of the
refinement of a site stand in ``road`` and ``site_refinement``; those of enforcement, which decide
on passes and measure nothing, in ``enforcement``.
"""
from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Mapping, Optional, Union

from .registry import DETECTORS, Registry, TRACKERS
from ..core.config import (
    ConfigRecord, read_yaml_mapping, record_of, section, TrackerConfig)
from ..core.errors import InputError
from ..road.problem import RoadPrior
from ..site.refine.config import RefineConfig
from ..steadying.config import SteadyingConfig


ENFORCEMENT = 'enforcement'  # section of a parameters file that is none of a pipeline's


@dataclass(frozen=True)
class SiteConfig:
    """What decides the paths of the lanes of a site, and how the rig stands there."""

    road: RoadPrior = section(RoadPrior, 'what is known of any road and rig beforehand')
    site_refinement: RefineConfig = section(RefineConfig, 'refinement of a site by images')
    steadying: SteadyingConfig = section(
        SteadyingConfig, 'rotation of the cameras in each pair, by what stands still')


@dataclass(frozen=True)
class PipelineConfig:
    """
    Everything one can set of a pipeline.

    :param shared: parameters that all trackers share.
    :param tracker: name of the tracker.
    :param detector: name of the detector.
    :param trackers: settings of trackers alone, by name; others have their defaults.
    :param detectors: settings of detectors alone, by name.
    :param site: parameters of the road and of the refinement of a site.
    :raises InputError: an unknown name.
    """

    shared: TrackerConfig = field(default_factory=TrackerConfig)
    tracker: str = 'constrained'
    detector: str = 'plane_sweep'
    trackers: Mapping[str, ConfigRecord] = field(default_factory=dict)
    detectors: Mapping[str, ConfigRecord] = field(default_factory=dict)
    site: SiteConfig = field(default_factory=SiteConfig)

    def __post_init__(self) -> None:
        TRACKERS.check(self.tracker)
        DETECTORS.check(self.detector)

    @property
    def tracker_settings(self) -> ConfigRecord:
        """Return the settings of the chosen tracker alone."""
        return _settings(TRACKERS, self.tracker, self.trackers)

    @property
    def detector_settings(self) -> ConfigRecord:
        """Return the settings of the chosen detector."""
        return _settings(DETECTORS, self.detector, self.detectors)

    def with_tolerances(self, tolerances: Mapping[str, float]) -> PipelineConfig:
        """Return it with the tolerances that a site file gives."""
        given: dict[str, Any] = dict(tolerances)
        return replace(self, shared=replace(self.shared, **given))

    def summary(self) -> dict[str, Any]:
        """Return what decided a run, as JSON values."""
        return {'parameters': asdict(self.shared),
                'tracker': self.tracker,
                'tracker_parameters': asdict(self.tracker_settings),
                'detector': self.detector,
                'detector_parameters': asdict(self.detector_settings),
                'site_parameters': asdict(self.site)}


def load_pipeline_config(path: Optional[Union[str, Path]], *, tracker: str = 'constrained',
                         detector: str = 'plane_sweep') -> PipelineConfig:
    """
    Read a file of parameters.

    :param path: YAML; None gives the defaults.
    :param tracker: name of the tracker.
    :param detector: name of the detector.
    :raises InputError: an unreadable file, an unknown key or name, a value out of bounds.
    """
    data = {} if path is None else dict(read_yaml_mapping(path))
    data.pop(ENFORCEMENT, None)  # of whoever decides on passes; read there
    trackers, detectors = (_sections(registry, data.pop(f'{registry.kind}s', {}), path)
                           for registry in (TRACKERS, DETECTORS))
    of_site = {f.name: data.pop(f.name) for f in fields(SiteConfig) if f.name in data}
    return PipelineConfig(record_of(TrackerConfig, data, path), tracker, detector, trackers,
                          detectors, record_of(SiteConfig, of_site, path))


def _sections(registry: Registry[Any], data: object, where: object) -> dict[str, ConfigRecord]:
    """Return the settings that a section of a file gives, by name."""
    if not isinstance(data, Mapping):
        raise InputError(where, f'{registry.kind}s', type(data).__name__,
                         f'a mapping of names of {registry.kind}s')
    for name in data:
        registry.check(str(name), f'{where}: {registry.kind}s')
    return {str(name): registry.settings(str(name), values, where)
            for name, values in data.items()}


def _settings(registry: Registry[Any], name: str, given: Mapping[str, ConfigRecord]
              ) -> ConfigRecord:
    return given[name] if name in given else registry.settings(name, {}, 'configuration')
