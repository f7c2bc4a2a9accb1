# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The choice of tracker and detector, and all parameters of a pipeline.

In a parameters file, the parameters that all trackers share are at the top level.  Those of one
tracker or detector are under its name in ``trackers`` or ``detectors``.  Those of the road and of
the refinement of a site are in ``road`` and ``site_refinement``.  Those of enforcement, which
decides on passes and measures nothing, are in ``enforcement``.
"""
from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Mapping, Optional, Union

from .registry import DETECTORS, Registry, TRACKERS
from ..core.config import ConfigRecord, read_yaml_mapping, record_of, section
from ..core.errors import InputError
from ..core.tracker_config import TrackerConfig
from ..road.problem import RoadPrior
from ..site.refine.config import RefineConfig
from ..steadying.config import SteadyingConfig


ENFORCEMENT = 'enforcement'  # section of a parameters file that no pipeline uses


@dataclass(frozen=True)
class SiteConfig:
    """Parameters that decide the lane paths of a site and the orientation of the rig there."""

    road: RoadPrior = section(RoadPrior, 'priors of any road and rig')
    site_refinement: RefineConfig = section(RefineConfig, 'refinement of a site by its images')
    steadying: SteadyingConfig = section(
        SteadyingConfig, 'rotation of the cameras in each pair, from the static background')


@dataclass(frozen=True)
class PipelineConfig:
    """
    All settings of a pipeline.

    :param shared: parameters that all trackers share.
    :param tracker: name of the tracker.
    :param detector: name of the detector.
    :param trackers: settings of single trackers, by name; the others have their defaults.
    :param detectors: settings of single detectors, by name.
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
        """Return the settings of the chosen tracker."""
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
        """Return all settings of a run, as JSON values."""
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
    data.pop(ENFORCEMENT, None)  # read by the room of that name
    trackers, detectors = (_sections(registry, data.pop(f'{registry.kind}s', {}), path)
                           for registry in (TRACKERS, DETECTORS))
    of_site = {f.name: data.pop(f.name) for f in fields(SiteConfig) if f.name in data}
    return PipelineConfig(record_of(TrackerConfig, data, path), tracker, detector, trackers,
                          detectors, record_of(SiteConfig, of_site, path))


def _sections(registry: Registry[Any], data: object, where: object) -> dict[str, ConfigRecord]:
    """Return the settings, by name, that a section of a file contains."""
    if not isinstance(data, Mapping):
        raise InputError(where, f'{registry.kind}s', type(data).__name__,
                         f'a mapping from names of {registry.kind}s to their parameters')
    for name in data:
        registry.check(str(name), f'{where}: {registry.kind}s')
    return {str(name): registry.settings(str(name), values, where)
            for name, values in data.items()}


def _settings(registry: Registry[Any], name: str, given: Mapping[str, ConfigRecord]
              ) -> ConfigRecord:
    return given[name] if name in given else registry.settings(name, {}, 'configuration')
