# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Parameter files: shared parameters, and those of one tracker or detector."""
from __future__ import annotations

import json

import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.pipeline.config import load_pipeline_config, PipelineConfig
from stereo_speed.pipeline.registry import DETECTORS, TRACKERS


@pytest.fixture
def load(tmp_path):
    """Return a function that reads a text as a file of parameters."""
    def read(text, **names):
        path = tmp_path / 'config.yaml'
        path.write_text(text)
        return load_pipeline_config(path, **names)
    return read


def test_no_file_gives_the_defaults():
    config = load_pipeline_config(None)
    assert config == PipelineConfig()
    assert config.tracker_settings == TRACKERS.load('constrained').Settings()
    assert config.detector_settings == DETECTORS.load('plane_sweep').Settings()


def test_sections_of_the_site_are_read(load):
    site = load('road: {pick_std_px: 0.5}\nsite_refinement: {few_pairs: 9}').site
    assert (site.road.pick_std_px, site.site_refinement.few_pairs) == (0.5, 9)


def test_sections_reach_their_component(load):
    config = load('particles: 50\nvisibility: {confirm_pairs: 5}\n'
                  'detectors: {plane_sweep: {interval_s: 0.2}}\n'
                  'trackers: {kalman: {match_std_px: 0.7}}', tracker='kalman')
    assert config.shared.particles == 50 and config.shared.visibility.confirm_pairs == 5
    assert config.detector_settings.interval_s == 0.2
    assert config.tracker_settings.match_std_px == 0.7
    assert load('{}', tracker='kalman').tracker_settings.match_std_px == 0.5


@pytest.mark.parametrize(('text', 'words'), [
    ('particle: 5', 'particle'), ('trackers: 3', 'trackers: found int'),
    ('trackers: {sonar: {}}', 'trackers: tracker: found sonar'),
    ('trackers: {kalman: {feature: 1}}', 'trackers.kalman.feature'),
    ('detectors: {plane_sweep: {interval_s: -1}}', 'detectors.plane_sweep.interval_s'),
    ('detectors: {plane_sweep: 1}', 'detectors.plane_sweep: found int'),
    ('site_refinement: {search_px: 0}', 'site_refinement.search_px: found 0'),
    ('road: {roll: 0}', 'road.roll'),
    ('verdict: {least_pairs: 1}', 'verdict.least_pairs: found 1'),
], ids=str)
def test_fault_is_named(text, words, load):
    with pytest.raises(InputError, match='config.yaml') as caught:
        load(text)
    assert words in str(caught.value)


@pytest.mark.parametrize('names', [{'tracker': 'sonar'}, {'detector': 'sonar'}], ids=str)
def test_unknown_names_are_refused(names):
    with pytest.raises(InputError, match='sonar'):
        PipelineConfig(**names)


def test_site_changes_only_the_tolerances():
    config = PipelineConfig().with_tolerances({'focal_std': 0.001, 'stamp_std_s': 0.002})
    assert (config.shared.focal_std, config.shared.stamp_std_s) == (0.001, 0.002)
    assert config.shared.baseline_std_m == TrackerConfig().baseline_std_m
    with pytest.raises(InputError, match='focal_std'):
        PipelineConfig().with_tolerances({'focal_std': 3.0})


def test_summary_is_json_and_names_every_choice():
    summary = json.loads(json.dumps(PipelineConfig(tracker='flow').summary()))
    assert (summary['tracker'], summary['detector']) == ('flow', 'plane_sweep')
    assert summary['parameters']['noise']['match_floor_px'] == 0.0125
    assert summary['detector_parameters']['interval_s'] == 0.09
    assert 'match_std_px' in summary['tracker_parameters']
