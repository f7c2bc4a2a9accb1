# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A swaying rig measures like one at rest, and a turning camera does not matter."""
from __future__ import annotations

from dataclasses import replace
import json

import numpy as np
import pytest
from stereo_speed.core.passes import Verdict
from stereo_speed.core.records import TrackState
from stereo_speed.enforcement.recompute import measure_again
from stereo_speed.io.trace_json import trace_of, trace_record
from stereo_speed.lab.evaluation.labeled_sequence import LineKnowledge, simulated_sequence
from stereo_speed.lab.sim.config import RigConfig, straight_config
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.pipeline.config import PipelineConfig, SiteConfig
from stereo_speed.pipeline.run import run
from stereo_speed.steadying.config import SteadyingConfig

MPH = 0.44704
SMALL = straight_config('50 mph', rig=RigConfig(width_px=512, height_px=384, f_px=900.0),
                        start_m=48.0, near_m=14.0, fps=10.0, pairs=14)
OFF = PipelineConfig(site=SiteConfig(steadying=SteadyingConfig(enabled=False)))
ON = PipelineConfig()


def measured(config, parameters=ON):
    """Return the pass, its true speed and the pipeline, measured on the exact lines."""
    sequence = simulated_sequence(config, (4,), LineKnowledge.EXACT)
    pipeline = sequence.site.pipeline(parameters, sequence.annotations)
    result, = run(pipeline, sequence.pairs).passes
    return result, 50 * MPH, pipeline


@pytest.fixture(scope='module')
def still():
    """Measure with a rig at rest."""
    return measured(SMALL)


@pytest.mark.slow
def test_fixed_rig_measures_as_without_steadying(still):
    result, _, pipeline = still
    assert pipeline.doubt.steadier.state().swayed == 0
    assert result.speed_mps == measured(SMALL, OFF)[0].speed_mps


@pytest.mark.slow
def test_sway_of_the_rig_does_not_affect_the_speed(still):
    moving = replace(SMALL, sway_deg=0.1)
    result, true, pipeline = measured(moving)
    assert result.verdict is Verdict.MEASURED and result.pairs >= still[0].pairs - 1
    assert abs(result.speed_mps - true) < 3 * result.speed_std_mps
    assert pipeline.doubt.steadier.state().swayed >= 10


@pytest.mark.slow
@pytest.mark.parametrize('played, reasons', [(0, 'rig_uncertain'), (1, 'rig_uncertain'), (2, '')])
def test_nothing_is_measured_before_the_rest_of_a_swaying_rig_is_known(played, reasons):
    """The live node has no later pairs to learn it from; ``replay`` has."""
    sequence = simulated_sequence(replace(SMALL, sway_deg=0.1), (4,), LineKnowledge.EXACT)
    assert sequence.site.reference.covariance_rad2.any()
    # The same pass three times, two seconds apart; the first two seconds and the first one of the
    # second time are too early.
    pairs = [replace(pair, index=pair.index + len(sequence.pairs) * k,
                     stamp_ns=pair.stamp_ns + 2 * k * 10**9,
                     right_stamp_ns=pair.right_stamp_ns + 2 * k * 10**9)
             for k in range(3) for pair in sequence.pairs]
    front, = sequence.annotations
    front = replace(front, frame=front.frame + len(sequence.pairs) * played)
    live = replace(sequence.site, reference=None).pipeline(ON, [front])
    found = run(live, pairs)
    result, = found.passes
    confirmed = [u for u in found.updates if u.state is TrackState.CONFIRMED]
    assert result.reason == reasons and bool(confirmed) == (not reasons)
    if not reasons:
        assert abs(result.speed_mps - 50 * MPH) < 4 * result.speed_std_mps
        assert result.trace.rest_std_rad is not None


@pytest.mark.slow
def test_pass_of_a_swaying_rig_is_recomputed_from_its_trace():
    """The direction of its lane was as uncertain as the rest of the rig."""
    sequence = simulated_sequence(replace(SMALL, sway_deg=0.1), (4,), LineKnowledge.EXACT)
    result, = run(sequence.site.pipeline(ON, sequence.annotations), sequence.pairs).passes
    trace = trace_of(json.loads(json.dumps(trace_record(result.trace))), 'trace')
    across, up = np.degrees(trace.rest_std_rad)
    assert 0.01 < across < 0.2 and 0.01 < up < 0.2
    taken = {pair.stamp_ns: pair for pair in sequence.pairs}
    pairs = [replace(taken[fed.stamp_ns], motion=fed.motion) for fed in trace.pairs]
    again = measure_again(trace, pairs, sequence.site, ON)
    assert again.speed_mps == result.speed_mps is not None
    certain = measure_again(replace(trace, rest_std_rad=None), pairs, sequence.site, ON)
    assert certain.budget.path_mps < again.budget.path_mps


def test_pairs_are_read_beforehand_only_as_far_as_needed():
    """Five of a rig at rest, and none where its sway is not estimated."""
    still = simulated_sequence(SMALL, (4,), LineKnowledge.PICKED)
    taken = []

    def first():
        for pair in still.pairs:
            taken.append(pair)
            yield pair
    place = MeasuringSite.of(still.site.site, still.site.rig, rest_by=first)
    assert place.reference is None and 5 <= len(taken) <= 6
    moving = simulated_sequence(replace(SMALL, sway_deg=0.1), (4,), LineKnowledge.EXACT)
    off = MeasuringSite.of(moving.site.site, moving.site.rig, config=OFF.site,
                           rest_by=lambda: moving.pairs)
    assert off.reference is None and moving.site.reference is not None


@pytest.mark.slow
def test_right_camera_that_rotates_during_the_pass_is_corrected():
    turned = replace(SMALL, right_turn_deg=(0.03, 0.0, 0.0), right_turn_s=0.45)
    result, true, pipeline = measured(turned)
    drift = pipeline.doubt.steadier.drift
    assert np.degrees(drift.corrected_rad[0]) == pytest.approx(0.03, abs=2e-3)
    assert result.speed_mps is None or abs(result.speed_mps - true) < 3 * result.speed_std_mps
    assert result.speed_mps is not None or result.reason == 'rig_uncertain'


@pytest.mark.slow
def test_site_is_refined_with_steadied_pairs():
    sequence = simulated_sequence(replace(SMALL, sway_deg=0.05), (4,), LineKnowledge.PICKED)
    rough = sequence.site
    place = MeasuringSite.of(rough.site, rough.rig, sequence.pairs, ON.site)
    assert place.reference is not None and np.degrees(
        np.abs(place.reference.rest_rad)).max() > 0.005
    assert place.refined.lost == ()
