# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Assembles a pipeline from a site, cameras, parameters and annotations."""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any, Callable, Iterable, Mapping, Optional, Sequence

import numpy as np

from .conclusions import Conclusions
from .config import PipelineConfig, SiteConfig
from .pipeline import SpeedPipeline
from .registry import DETECTORS, TRACKERS
from .solving import SolvingBeside
from ..core.errors import SiteError
from ..core.records import InitialFront, StereoPair
from ..detection.protocol import Detector
from ..geometry.rig import StereoRig
from ..geometry.steadied import steadied
from ..road.lanes import LanePath
from ..site.file import Site
from ..site.lane_paths import lane_paths
from ..site.refine.empty_road import spread_pairs
from ..site.refine.refiner import refine_site, RefinedSite
from ..steadying.config import SteadyingConfig
from ..steadying.steadier import Reference, rest_of, Steadier

# Most pairs that the rest of a rig is learnt from beforehand, and most that show no details.
_MOST_REST_PAIRS, _MOST_BLANK = 1000, 20

MakeDetector = Callable[[StereoRig, Mapping[str, LanePath], Any], Detector]  # last, its settings


@dataclass(frozen=True, eq=False)
class MeasuringSite:
    """
    A site, ready to be measured at.

    :param site: as read, or as refined.
    :param rig: the cameras with the site's correction of the rig applied.
    :param lanes: lane name to lane path.
    :param refined: result of the refinement; None where there was none.
    :param not_refined: why a requested refinement failed, so that the site is used as read; empty
        otherwise.
    :param reference: the pair that the rig's sway is measured against, and how the rig stands in
        the site, relative to that pair; None to learn it from the first measured pairs.
    :param corrected: whether lines and rig come from later checks of the rig, not from the file.
    """

    site: Site
    rig: StereoRig
    lanes: Mapping[str, LanePath]
    refined: Optional[RefinedSite] = None
    not_refined: str = ''
    reference: Optional[Reference] = None
    corrected: bool = False

    @classmethod
    def of(cls, site: Site, rig: StereoRig,
           refine_by: Optional[Iterable[StereoPair]] = None,
           config: SiteConfig = SiteConfig(), *,
           rest_by: Optional[Callable[[], Iterable[StereoPair]]] = None
           ) -> MeasuringSite:
        """
        Return a site ready to be measured at.

        :param site: as read.
        :param rig: the cameras as calibrated.
        :param refine_by: pairs to refine the site by; where that fails, the site is used as read.
            None to use it as read without refinement.
        :param config: priors of roads, and how to refine.
        :param rest_by: returns the pairs that will be measured, of which the first tell the rest
            of a rig that sways, unless the site is refined.  None to learn it while measuring.
        :raises SiteError: the lines give no usable road.
        """
        not_refined = ''
        if refine_by is not None:
            try:
                refined, reference = refined_site(site, rig, refine_by, config)
                return cls(refined.site, refined.rig, refined.lanes, refined,
                           reference=reference)
            except SiteError as error:
                not_refined = str(error)
        corrected = site.corrected_rig(rig)
        return cls(site, corrected, lane_paths(site, corrected, config.road),
                   not_refined=not_refined,
                   reference=None if rest_by is None else _swaying_reference(
                       corrected, rest_by(), config.steadying))

    def pipeline(self, config: PipelineConfig,
                 annotations: Optional[Sequence[InitialFront]] = None, *,
                 conclusions: Optional[Conclusions] = None,
                 solving: Optional[SolvingBeside] = None, detect: Optional[MakeDetector] = None,
                 seed: int = 0, where: str = 'init file') -> SpeedPipeline:
        """
        Return a pipeline that measures at this site, with the tolerances that the site gives.

        The arguments are those of :func:`make_pipeline`.
        """
        return make_pipeline(self.rig, self.lanes, config.with_tolerances(self.site.tolerances),
                             annotations, reference=self.reference, conclusions=conclusions,
                             solving=solving, detect=detect, seed=seed, where=where)


def refined_site(site: Site, rig: StereoRig, pairs: Iterable[StereoPair],
                 config: SiteConfig = SiteConfig()) -> tuple[RefinedSite, Optional[Reference]]:
    """
    Refine a site by images, with the sway of the rig removed.

    :param site: clicked, or refined before.
    :param rig: the cameras as calibrated.
    :param pairs: any number of pairs; some, spread over them, are used.
    :param config: priors of roads, how to refine, and how the rig is steadied.
    :return: the refined site, and the reference of the sway; None where it is not estimated.
    :raises SiteError: the lines give no usable road, or the right camera has turned too far.
    :raises InputError: there are no pairs.
    """
    steady, reference = steadied_pairs(rig, spread_pairs(pairs), config.steadying)
    refined = refine_site(site, rig, steady, config.site_refinement, config.road)
    if reference is not None and refined.is_found:
        # The lines turn with an error of the rest, which is thus none.
        reference = replace(reference, covariance_rad2=np.zeros((3, 3)))
    return refined, reference


def steadied_pairs(rig: StereoRig, pairs: Sequence[StereoPair], config: SteadyingConfig
                   ) -> tuple[list[StereoPair], Optional[Reference]]:
    """
    Return pairs as the rig would have taken them at rest, and the reference of its sway.

    :param pairs: a few pairs, spread over some time.
    :param config: how the sway is found; where it is disabled, pairs are returned unchanged.
    """
    reference = rest_of(Steadier(rig, _each_pair(config)), pairs) if config.enabled else None
    if reference is None:
        return list(pairs), None
    steadier = Steadier(rig, _each_pair(config), reference)
    return [steadied(steadier.steady(pair), rig) for pair in pairs], reference


def _swaying_reference(rig: StereoRig, pairs: Iterable[StereoPair], config: SteadyingConfig
                       ) -> Optional[Reference]:
    """
    Return the reference of a rig that sways from the start, by the mean of its first pairs.

    :return: None if it stands still at first, or shows no details; the first pair that does is
        its reference then.
    """
    if not config.enabled:
        return None
    steadier = Steadier(rig, _each_pair(config))
    for pair in islice(pairs, _MOST_REST_PAIRS):
        steadier.steady(pair)
        state = steadier.state()
        if steadier.standing_is_fixed or state.unknown >= _MOST_BLANK and not state.swayed:
            break
    reference = steadier.learnt
    return None if reference is None or not reference.covariance_rad2.any() else reference


def _each_pair(config: SteadyingConfig) -> SteadyingConfig:
    """Return parameters that have every pair looked at, for a few pairs far apart in time."""
    return replace(config, look_interval_s=0.0)


def make_pipeline(rig: StereoRig, lanes: Mapping[str, LanePath], config: PipelineConfig,
                  annotations: Optional[Sequence[InitialFront]] = None, *,
                  reference: Optional[Reference] = None,
                  conclusions: Optional[Conclusions] = None,
                  solving: Optional[SolvingBeside] = None, detect: Optional[MakeDetector] = None,
                  seed: int = 0, where: str = 'init file') -> SpeedPipeline:
    """
    Return a pipeline with the tracker and the detector that the parameters name.

    :param rig: the cameras, corrected as the site says.
    :param lanes: lane name to lane path.
    :param config: names and parameters.
    :param annotations: fronts that a person annotated; None to have vehicles detected.
    :param reference: reference of the rig's sway; None to learn it from the first pairs.
    :param conclusions: measures passes that are over; None to measure them at once.
    :param solving: thread that solves for vehicles where pairs come faster than
        ``effort.solve_interval_s``; None to make each reading wait for its solution.
    :param detect: makes the detector; None for the class that the parameters name.
    :param seed: seed of all randomness.
    :param where: source of the annotations, for error messages.
    :raises InputError: an annotation outside the images, no lane, or a tracker or detector that
        cannot be loaded.
    """
    start = partial(TRACKERS.load(config.tracker).start, settings=config.tracker_settings)
    make = detect or DETECTORS.load(config.detector)
    detector = None if annotations is not None else make(rig, lanes, config.detector_settings)
    steadying = config.site.steadying
    steadier = Steadier(rig, steadying, reference) if steadying.enabled else None
    return SpeedPipeline(rig, lanes, config.shared, start, annotations=annotations or (),
                         detector=detector, steadier=steadier, conclusions=conclusions,
                         solving=solving, seed=seed, where=where)
