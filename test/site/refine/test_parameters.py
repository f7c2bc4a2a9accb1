# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the refinement changes some result or message."""
from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, Callable, Mapping

import numpy as np
import pytest
from stereo_speed.core.config import parameters_of
from stereo_speed.core.errors import SiteError
from stereo_speed.core.records import StereoPair
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.road.problem import RoadPrior
from stereo_speed.site.extras import KnownLength, LinesApart
from stereo_speed.site.refine.config import RefineConfig
from stereo_speed.site.refine.empty_road import Background
from stereo_speed.site.refine.extrinsic_drift import decide_drift, FamilyDrift
from stereo_speed.site.refine.known_lengths import check_lengths
from stereo_speed.site.refine.markings import locate
from stereo_speed.site.refine.refiner import refine_site
from stereo_speed.site.refine.report import report
from stereo_speed.site.refine.rig_check import epipolar_check
from stereo_speed.site.write import site_text

# When clicks win over markings: test_refiner.py; what light does: test_markings.py;
# markings that were not clicked: test_clicked.py, test_unresolved.py.
ELSEWHERE = 'disagreement_sigmas', 'disagreement_factor', 'steady_share', 'clicked_sigmas'
FIELDS = {**{n: f for n, f in parameters_of(RefineConfig) if n not in ELSEWHERE},
          **{n: dict(parameters_of(RoadPrior))[n] for n in ('calibrated_std_deg', 'taper_std_m')}}


def configured(name: str, value: Any) -> tuple[RefineConfig, RoadPrior]:
    """Return the parameters with one of them set, or none."""
    if name in {f for f, _ in parameters_of(RoadPrior)}:
        return RefineConfig(), RoadPrior(**{name: value})
    return RefineConfig(**({name: value} if name else {})), RoadPrior()


@pytest.fixture(scope='module')
def results(drawn, drawn_off, drawn_refined) -> Mapping[str, Callable[..., Any]]:
    """Return functions from parameters to their results, fast ones first."""
    rng = np.random.default_rng(2)
    texture = rng.normal(0, 14, (360, 640))
    images = [np.clip(drawn.image(right) + texture, 0, 255).astype(np.uint8) for right in (0, 1)]
    row = int(drawn.lines['right'].left_px[7, 1])
    rows = slice(row - 12, row + 13)
    images[0][rows] = np.roll(images[0][rows], 1, axis=1)  # a piece of line that lies beside it
    views = Background(images[0].astype(np.float32), 1.0, 9), Background(
        images[1].astype(np.float32), 1.0, 9)
    dashed = drawn_off.image(0, period_m=8.0, noise=2.0)
    known = replace(drawn_refined, site=replace(drawn_refined.site, known_lengths=(
        KnownLength('lane', 3.51, 0.002, LinesApart(('right', 'left'))),)))

    def drift(config, prior):
        shown = FamilyDrift(
            0.0, np.radians([0.01, 0.001, -0.01]), np.radians(0.002)**2 * np.eye(3))
        found = decide_drift([shown], config, prior)
        return found.moved_probability, *found.drift_rad, *found.std_rad

    def said(config, prior):
        told = replace(known, config=config)
        return report(told).warnings, [length.wrong for length in check_lengths(told)]

    def marking(config, prior):
        found = locate(drawn_off.view('right', 0, dashed, 2.0),
                       drawn_off.lines['right'].views_px[0][[0, -1]], config=config)
        return None if found is None else [found.uv_px.tolist(), found.std_px.tolist()]

    def details(config, prior):
        found = epipolar_check(drawn.rig, views, drawn.fit.plane, config)
        return found.information.tolist()

    def whole(config, prior):
        moved = drawn.rig.drifted(np.radians([0.0, 0.1, 0.0]))
        rig = StereoRig(moved.left, moved.right, moved.R, moved.t)
        try:
            return site_text(refine_site(drawn.site, rig, [StereoPair(0, 0, 0, *images)],
                                         config, prior).site)
        except SiteError as error:
            return str(error)
    return {f.__name__: f for f in (drift, said, marking, details, whole)}


@pytest.fixture(scope='module')
def outcome(results) -> Callable[[str, str, Any], Any]:
    """Return the function from a result, a parameter and its value to the outcome."""
    @lru_cache(maxsize=None)
    def of(result: str, name: str, value: Any) -> Any:
        return results[result](*configured(name, value))
    return of


@pytest.mark.slow
@pytest.mark.parametrize('name', FIELDS)
def test_every_parameter_changes_something(name, results, outcome):
    known = FIELDS[name]
    values = [v for v in (known.metadata['low'], known.metadata['high']) if v != known.default]
    assert any(outcome(result, name, value) != outcome(result, '', None)
               for result in results for value in values)
