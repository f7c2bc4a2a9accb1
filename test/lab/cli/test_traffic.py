# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The ``traffic`` command: renders aside, scores, writes, refuses."""
from __future__ import annotations

import csv
import itertools
import json
from unittest import mock

import numpy as np
import pytest

from stereo_speed.cli import main as cli
from stereo_speed.lab.cli import traffic
from stereo_speed.lab.evaluation import traffic as evaluation
from stereo_speed.lab.sim import RigConfig, traffic_config, TrafficStream
from stereo_speed.pipeline.assembly import make_pipeline

SMALL = RigConfig(width_px=320, height_px=240, f_px=560.0)


def test_pairs_from_another_process_are_the_same():
    config = traffic_config('day', minutes=0.1, vehicles=6, rig=SMALL)
    own = TrafficStream(config, np.random.default_rng(4))
    aside = traffic.rendered(config, 4)
    count = 0
    for one, other in itertools.islice(zip(own, aside), 5):
        assert np.array_equal(one.pair.right, other.pair.right)
        assert one.truth == other.truth
        count += 1
    aside.close()
    assert count == 5


def test_what_goes_wrong_while_rendering_is_told():
    config = traffic_config('day', minutes=0.1, vehicles=6, rig=SMALL)
    with mock.patch.object(traffic, 'get_context') as context:
        queue = context.return_value.Queue.return_value
        queue.get.side_effect = [ValueError('no such road')]
        with pytest.raises(ValueError, match='no such road'):
            next(traffic.rendered(config, 0))
    assert context.return_value.Process.return_value.terminate.called


def test_refined_lanes_are_nearer_to_the_true_ones():
    """By other traffic on the same road: its looks and clicks are those of the stream."""
    config = traffic_config('day', lanes=2, minutes=1.0, vehicles=10, rig=SMALL)
    exact, picked, refined = (traffic.known_road(config, 3, lines)[1]['lane_0'].path
                              for lines in ('exact', 'picked', 'refined'))
    points = exact.position(np.linspace(0.2, 0.8, 5) * exact.length_m)
    off_m = [np.linalg.norm(path.position(path.arc_length(points)) - points, axis=1).max()
             for path in (picked, refined)]
    assert off_m[0] > 0.01 and off_m[1] < 0.1 * off_m[0]


def test_files_and_table(tmp_path, capsys, monkeypatch):
    """With a pipeline that is given no marks, every vehicle is missed and nothing is false."""
    monkeypatch.setattr(traffic, 'make_pipeline', lambda rig, lanes, config, seed: make_pipeline(
        rig, lanes, config, (), seed=seed))
    monkeypatch.setattr(traffic, 'RIGS', {'parallel': SMALL})
    monkeypatch.setattr(evaluation, 'SEEN_PX', 10.0)
    out = tmp_path / 'out'
    assert cli.main(['traffic', '--minutes', '0.06', '--vehicles', '12', '--fps', '5',
                     '--jobs', '1', '--lines', 'picked', '--out', str(out)]) == 0
    table = capsys.readouterr().out.splitlines()
    cells = [cell.strip() for cell in table[-1].split('|')]
    names = [cell.strip() for cell in table[0].split('|')]
    row = dict(zip(names, cells))
    assert int(row['vehicles']) > 0 and row['vehicles'] == row['missed']
    assert row['false tracks'] == row['measured once'] == '0'
    with (out / 'truth.csv').open() as file:
        rows = list(csv.DictReader(file))
    assert len({r['vehicle'] for r in rows}) >= int(row['vehicles'])
    assert json.loads((out / 'summary.json').read_text())['score']['missed'] == int(row['missed'])
    assert (out / 'tracks.csv').read_text().count('\n') == 1


def test_a_short_stream_is_measured(tmp_path, capsys):
    """15 s of the traffic of the docs' table: each vehicle once, none wrong, nothing false."""
    assert cli.main(['traffic', '--minutes', '0.25', '--vehicles', '5', '--fps', '5', '--lanes',
                     '2', '--lines', 'exact', '--particles', '200', '--seed', '1']) == 0
    names, cells = ([cell.strip() for cell in line.split('|')]
                    for line in itertools.compress(
                        capsys.readouterr().out.splitlines(), (1, 0, 1)))
    row = dict(zip(names, cells))
    assert int(row['vehicles']) >= 3 and row['measured once'] == row['vehicles']
    assert row['false tracks'] == row['wrong by > 1 mph'] == '0'


@pytest.mark.parametrize('words, said', [
    (['--lanes', '2', '--receding', '2'], '--receding: found 2, wanted fewer than 2'),
    (['--light', 'noon'], '--light'), (['--minutes', '0'], '--minutes'),
    (['--particles', '1'], 'particles'), (['--lane-changes', '0'], '--lane-changes'),
    (['--out', 'a', '--bag', 'b'], 'not allowed')])
def test_bad_options_are_one_line(words, said, capsys):
    assert cli.main(['traffic', *words]) == 2
    err = capsys.readouterr().err
    assert said in err and err.count('\n') == 1
