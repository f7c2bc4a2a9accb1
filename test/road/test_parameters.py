# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the road prior changes some lane."""
from __future__ import annotations

from functools import lru_cache
import math
from typing import Any, Callable, Mapping

import numpy as np
import pytest
from stereo_speed.core.config import parameters_of
from stereo_speed.road.fit import fit_road
from stereo_speed.road.lanes import lane_of_road, LanePath
from stereo_speed.road.problem import RoadPrior
from stereo_speed.site.file import LaneSpec, Site, SurveyedLine
from stereo_speed.site.lane_paths import lane_paths

FIELDS = dict(parameters_of(RoadPrior))
Maker = Callable[[RoadPrior], LanePath]


def figures(lane: LanePath) -> np.ndarray:
    """Return the properties of a lane that a measurement uses."""
    at = np.linspace(0, 1, 5) * lane.path.length_m
    return np.array([*lane.path.position(at).ravel(), *lane.heading_std_rad, lane.scale_std,
                     lane.shape_std])


@pytest.fixture(scope='module')
def makers(make_scene) -> Mapping[str, Maker]:
    """Return makers of lanes by name, the fast ones first."""
    def fitted(std_px: float = 0.3, **road: float) -> Maker:
        scene = make_scene(std_px=std_px, **road)
        std = {name: tuple(np.full(len(uv), std_px) for uv in views)
               for name, views in scene.lines.items()} if std_px < 0.3 else None
        return lambda prior: lane_of_road(
            'lane', fit_road(scene.rig, scene.lines, std, prior=prior), (0, 1), None)
    points_m = np.column_stack([np.zeros(5), np.full(5, 2.0), np.linspace(60.0, 20.0, 5)])
    surveyed = Site('site.yaml', 'test', {'middle': SurveyedLine('middle', points_m)},
                    (LaneSpec('lane', None, None, 'middle', None),))
    rig = make_scene().rig
    return {'surveyed': lambda prior: lane_paths(surveyed, rig, prior)['lane'],
            'clicked': fitted(), 'precise': fitted(std_px=0.005),
            'line that steps': fitted(std_px=0.03, step_m=0.03),
            'crest': fitted(crest=1 / 150, std_px=0.1),
            'climbing bend': fitted(curvature=1 / 41, grade=0.02),
            'twisted bend': fitted(curvature=1 / 41, twist=0.08, std_px=0.1),
            'hardly twisted bend': fitted(curvature=1 / 41, twist=0.02, std_px=0.1)}


@pytest.fixture(scope='module')
def made(makers) -> Callable[[str, str, float], np.ndarray]:
    """Return the function that makes a lane with a parameter at a value, with a cache."""
    @lru_cache(maxsize=None)
    def of(scene: str, name: str, value: float) -> np.ndarray:
        return figures(makers[scene](RoadPrior(**({name: value} if name else {}))))
    return of


def values(name: str) -> list[Any]:
    """Return values of a parameter other than its default."""
    known = FIELDS[name]
    low, high = known.metadata['low'], known.metadata['high']
    return [v for v in (min(3 * known.default, high), low, high) if v != known.default]


# The lanes that these change; others are tried if they do not.
LIKELY = {'grade_std_rad': 'climbing bend', 'crossfall_std_rad': 'climbing bend',
          'twist_std_rad': 'twisted bend', 'crest_std_per_m': 'crest',
          'vertical_curve_m': 'crest', 'vertical_curve_log_std': 'crest'}

# These have an effect in the refinement: test/site/refine/test_parameters.py.
ELSEWHERE = 'calibrated_std_deg', 'taper_std_m'


@pytest.mark.slow
@pytest.mark.parametrize('name', [n for n in FIELDS if n not in ELSEWHERE])
def test_every_parameter_changes_something(name, makers, made):
    def moved(scene: str, value: float) -> float:
        usual = made(scene, '', math.nan)
        now = made(scene, name, value)
        return float(np.abs(now[usual != 0] / usual[usual != 0] - 1).max())
    scenes = sorted(makers, key=lambda scene: scene != LIKELY.get(name))
    assert any(moved(scene, value) > 1e-6 for scene in scenes for value in values(name))
