# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the tracker node, as seen by other nodes."""
from __future__ import annotations

import pytest

pytest.importorskip('rclpy')

from rcl_interfaces.srv import DescribeParameters, ListParameters  # noqa: E402

from stereo_speed.cli.demo import Process  # noqa: E402
from stereo_speed.core.config import parameters_of  # noqa: E402
from stereo_speed.core.tracker_config import TrackerConfig  # noqa: E402
from stereo_speed.detection.config import DetectorConfig  # noqa: E402
from stereo_speed.nodes import tracker, tracker_node  # noqa: E402
from stereo_speed.nodes.common import run  # noqa: E402
from stereo_speed.pipeline.config import SiteConfig  # noqa: E402

STARTUP_S, EVENT_S = 60.0, 20.0
FIELDS = {**dict(parameters_of(TrackerConfig)),
          **dict(parameters_of(SiteConfig)),
          **dict(parameters_of(DetectorConfig, 'detectors.plane_sweep.'))}


@pytest.mark.slow
def test_every_parameter_is_declared_with_its_meaning_and_bounds(stand_in, sample):
    def answer(kind, service, **request):
        client = stand_in.create_client(kind, f'/tracker_node/{service}')
        stand_in.wait(client.service_is_ready, STARTUP_S)
        future = client.call_async(kind.Request(**request))
        stand_in.wait(future.done, EVENT_S)
        return future.result()

    with Process('tracker_node', f'site:={sample / "site.yaml"}'):
        declared = answer(ListParameters, 'list_parameters').result.names
        assert set(FIELDS) <= set(declared)
        described = answer(DescribeParameters, 'describe_parameters', names=list(FIELDS))
    for (name, field), found in zip(FIELDS.items(), described.descriptors, strict=True):
        meta = field.metadata
        assert found.name == name and found.read_only
        assert found.description.startswith(meta['doc']) and meta['unit'] in found.description
        ranges = [*found.floating_point_range, *found.integer_range]
        if meta['choices']:
            assert not ranges and all(str(c) in found.description for c in meta['choices'])
        elif isinstance(field.default, bool):
            assert not ranges
        else:
            assert [(r.from_value, r.to_value) for r in ranges] == [(meta['low'], meta['high'])]


@pytest.mark.usefixtures('private_graph')
@pytest.mark.parametrize('given, words', [
    ('parts:=5', ['parts', '4, 6, 8']),
    ('verdict.least_pairs:=1', ['verdict.least_pairs']),
    ('effort.pass_observations:=10', ['effort.pass_observations', 'live_observations']),
    ('detectors.plane_sweep.motion.least_ncc:=2.0', ['detectors.plane_sweep.motion.least_ncc']),
    ('detector:=radar', ['detector', 'radar', 'plane_sweep'])])
def test_invalid_value_ends_the_node_with_one_line(given, words, sample, capfd):
    assert tracker_node.main(
        ['--ros-args', '-p', f'site:={sample / "site.yaml"}', '-p', given]) == 2
    line, = capfd.readouterr().err.splitlines()
    assert line.startswith('error: ') and all(word in line for word in words)


@pytest.mark.usefixtures('private_graph')
@pytest.mark.parametrize('given, said', [
    (['trackers.kalman.most_ratio:=0.5', 'use_sim_time:=true', 'detectors.boxes.fit.x:=1',
      'qos_overrides./tracks.publisher.depth:=9'], None),
    (['stamp_std:=0.1', 'detectors.plane_sweep.intervall_s:=1.0', 'trackers.karman.x:=1'],
     'unknown parameters ignored: detectors.plane_sweep.intervall_s, stamp_std, '
     'trackers.karman.x')])
def test_misspelt_name_is_reported_and_an_unused_choice_is_not(given, said, sample, capfd):
    values = [f'site:={sample / "site.yaml"}', *given]
    assert run(tracker.TrackerNode, ['--ros-args', *(w for v in values for w in ('-p', v))],
               spin=lambda node: None) == 0
    error = capfd.readouterr().err
    assert error == '' if said is None else error.count('\n') == 1 and said in error
