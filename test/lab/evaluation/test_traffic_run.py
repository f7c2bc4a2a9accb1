# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated traffic through the pipeline, to its files."""
from __future__ import annotations

import csv
import itertools
import json

import numpy as np
import pytest
from stereo_speed.core.records import StereoPair
from stereo_speed.lab.evaluation.labeled_sequence import LineKnowledge
from stereo_speed.lab.evaluation.producer import produced
from stereo_speed.lab.evaluation.traffic import TrafficRules
from stereo_speed.lab.evaluation.traffic_run import (
    measure_traffic, stream_of, traffic_site, write_traffic)
from stereo_speed.lab.sim import RigConfig, traffic_config, TrafficPair
from stereo_speed.pipeline.config import PipelineConfig

SMALL = RigConfig(width_px=320, height_px=240, f_px=560.0)
CONFIG = traffic_config('day', minutes=0.06, vehicles=12, fps=5.0, rig=SMALL)


def dark_pairs(count):
    """Yield black pairs, with one vehicle throughout and another that comes late."""
    image = np.zeros((SMALL.height_px, SMALL.width_px), np.uint8)
    row = {'speed': 20.0, 'path_speed': 20.0, 'lateral': 0.0, 'x': 0.0, 'y': 1.0, 'z': 40.0,
           'width_px': 60.0, 'lane': 0, 'visible': 1.0, 'in_view': True}
    for k in range(count):
        stamp_ns = k * 200_000_000
        rows = tuple({**row, 'stamp': f'{k / 5:.6f}', 'stamp_ns': stamp_ns, 'vehicle': n}
                     for n in (3, 8) if n == 3 or k > 4)
        yield TrafficPair(StereoPair(k, stamp_ns, stamp_ns, image, image), rows)


@pytest.mark.slow
def test_pairs_from_another_process_are_the_same():
    aside = produced(stream_of, CONFIG, 4)
    for one, other in itertools.islice(zip(stream_of(CONFIG, 4), aside), 2):
        assert np.array_equal(one.pair.right, other.pair.right)
        assert one.truth == other.truth
    aside.close()


@pytest.mark.slow
def test_refined_lanes_are_nearer_to_the_true_ones():
    """By other traffic on the same road, with the stream's appearance and clicks."""
    config = traffic_config('day', lanes=2, minutes=1.0, vehicles=10, rig=SMALL)
    exact, picked, refined = (traffic_site(config, 3, lines).lanes['lane_0'].path for lines in (
        LineKnowledge.EXACT, LineKnowledge.PICKED, LineKnowledge.REFINED))
    points = exact.position(np.linspace(0.2, 0.8, 5) * exact.length_m)
    off_m = [np.linalg.norm(path.position(path.arc_length(points)) - points, axis=1).max()
             for path in (picked, refined)]
    assert off_m[0] > 0.01 and off_m[1] < 0.1 * off_m[0]


def test_pipeline_without_annotations_misses_every_vehicle(tmp_path):
    site = traffic_site(CONFIG, 0, LineKnowledge.PICKED)
    result = measure_traffic(dark_pairs(8), site.pipeline(PipelineConfig(), ()), 8)
    score = result.score(TrafficRules(seen_s=1.4))
    assert (score.vehicles, score.missed, score.brief) == (1, 1, 1)
    assert score.false_tracks == score.once == 0
    assert result.pair_ms > 0 and result.lanes == ('lane_0', 'lane_1', 'lane_2')
    write_traffic(tmp_path, result, score, {'seed': 0})
    with (tmp_path / 'truth.csv').open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(result.truth)
    assert {r['vehicle'] for r in rows} == {'3', '8'}
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert summary['score']['missed'] == score.missed and 'passes' not in summary['score']
    assert (summary['seed'], summary['timings']['pairs']) == (0, len(result.run.stamps_ns))
    assert (tmp_path / 'tracks.csv').read_text().count('\n') == 1
