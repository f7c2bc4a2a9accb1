# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Measure the open bag with the drawn site, as a trial."""
from __future__ import annotations

from .runs import RunFolder
from .scene import Scene
from ..io.bags import StereoBag
from ..pipeline.assembly import MeasuringSite
from ..pipeline.config import PipelineConfig
from ..pipeline.run import Run, run
from ..site.file import Site


def measure(scene: Scene, site: Site, name: str, settings: PipelineConfig) -> RunFolder:
    """
    Measure all vehicles of a bag like ``replay``; call it in the bag's thread only.

    :param scene: the bag.
    :param site: the site.
    :param name: name for the run.
    :param settings: all parameters.
    """
    def work(bag: StereoBag) -> Run:
        place = MeasuringSite.of(site, scene.rig, config=settings.site, rest_by=bag.pairs)
        return run(place.pipeline(settings), bag.pairs())
    result = scene.run_over(work)
    summary = {'input': {'bag': scene.path.resolve().name, 'bag_sha256': scene.content_hash()},
               'seed': 0, **settings.with_tolerances(site.tolerances).summary()}
    return RunFolder.measured(name, result.updates, result.passes, summary)
