# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""From a site file to a pipeline: tolerances, corrections and refinement are all applied."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.core.errors import InputError, SiteError
from stereo_speed.core.records import InitialFront
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.detection.detector import PlaneSweepDetector
from stereo_speed.io.bags import StereoBag
from stereo_speed.pipeline.assembly import make_pipeline, MeasuringSite
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.site.file import load_site
import yaml


@pytest.fixture(scope='module')
def bag(sample):
    """Open the sample's bag."""
    with StereoBag(sample / 'bag') as opened:
        yield opened


@pytest.fixture
def site_with(sample, tmp_path):
    """Return the sample's site with additional keys."""
    def write(**keys):
        data = yaml.safe_load((sample / 'site.yaml').read_text())
        (tmp_path / 'site.yaml').write_text(yaml.safe_dump({**data, **keys}))
        return load_site(tmp_path / 'site.yaml')
    return write


def test_tolerances_of_the_site_are_used(bag, site_with):
    place = MeasuringSite.of(site_with(tolerances={'focal_std': 0.004}), bag.rig)
    pipeline = place.pipeline(PipelineConfig(TrackerConfig(particles=77)), None)
    assert pipeline.config.focal_std == 0.004 and pipeline.config.particles == 77
    assert pipeline.config.baseline_std_m == TrackerConfig().baseline_std_m


def test_rig_is_corrected_as_the_site_says(bag, site_with):
    turn_deg = [0.02, -0.01, 0.03]
    place = MeasuringSite.of(site_with(rig_correction={
        **dict(zip(('pan_deg', 'tilt_deg', 'roll_deg'), turn_deg)),
        'covariance_deg2': (1e-6 * np.eye(3)).tolist()}), bag.rig)
    angle = np.arccos((np.trace(place.rig.R @ bag.rig.R.T) - 1) / 2)
    assert np.degrees(angle) == pytest.approx(np.linalg.norm(turn_deg), rel=1e-4)
    assert place.pipeline(PipelineConfig(), None).rig is place.rig


@pytest.mark.slow
def test_refined_site_is_used_for_measuring(bag, sample):
    rough = load_site(sample / 'site.yaml')
    place = MeasuringSite.of(rough, bag.rig, bag.pairs())
    assert place.refined is not None and place.site is place.refined.site
    for name, line in place.site.lines.items():
        assert len(line.left_px) > len(rough.lines[name].left_px)
    assert set(place.lanes) == {lane.name for lane in rough.lanes}


def test_vehicles_are_detected_where_none_are_annotated(bag, sample):
    place = MeasuringSite.of(load_site(sample / 'site.yaml'), bag.rig)
    assert isinstance(place.pipeline(PipelineConfig(), None).detector, PlaneSweepDetector)
    assert place.pipeline(PipelineConfig(), ()).detector is None


def test_unusable_inputs_are_refused(bag, sample):
    place = MeasuringSite.of(load_site(sample / 'site.yaml'), bag.rig)
    with pytest.raises(InputError, match='lanes: found none'):
        make_pipeline(bag.rig, {}, PipelineConfig())
    quad = np.array([[10.0, 10.0], [50.0, 10.0], [50.0, 40.0], [10.0, 40.0]])
    with pytest.raises(InputError, match='marks.yaml: .*right_image'):
        make_pipeline(bag.rig, place.lanes, PipelineConfig(),
                      [InitialFront(0, quad, quad - 30.0)], where='marks.yaml')


def test_site_that_cannot_be_refined_is_used_as_read(bag, sample, monkeypatch):
    """The reason is reported."""
    def refuse(*_):
        raise SiteError('site.yaml', 'pan', '+1 degrees', 'at most 0.3')
    monkeypatch.setattr('stereo_speed.pipeline.assembly.refine_site', refuse)
    rough = load_site(sample / 'site.yaml')
    place = MeasuringSite.of(rough, bag.rig, bag.pairs())
    assert place.refined is None and place.site is rough and place.rig is bag.rig
    assert set(place.lanes) == {lane.name for lane in rough.lanes}
    assert place.not_refined == 'site.yaml: pan: found +1 degrees, wanted at most 0.3'
    assert MeasuringSite.of(rough, bag.rig).not_refined == ''
