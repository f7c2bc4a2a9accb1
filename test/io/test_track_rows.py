# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``tracks.csv`` written during the run equals one written at once, with little memory."""
from __future__ import annotations

from dataclasses import replace
import os

import numpy as np
import pytest
from stereo_speed.core.passes import PassResult, Verdict
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.io.results import tracks_csv
from stereo_speed.io.track_rows import TrackRows

UPDATE = TrackUpdate(
    stamp_ns=0, track=0, lane='a, "b"', state=TrackState.CONFIRMED, speed_mps=20.0,
    speed_std_mps=0.1, s_m=1.0, lateral_m=0.0, position_m=np.ones(3), position_cov_m2=np.eye(3),
    axes=np.eye(3), quad_left_px=np.zeros((4, 2)), quad_right_px=np.zeros((4, 2)))
PASS = PassResult(track=0, lane='a', first_ns=0, last_ns=1, pairs=1, speed_mps=20.0,
                  speed_std_mps=0.1, verdict=Verdict.MEASURED, reason='', smoothed={},
                  smoothed_std={})


def drive(rng, pairs):
    """Make random traffic: for each pair its updates, the finished passes, and the open tracks."""
    alive, number, steps = {}, 0, []
    for k in range(pairs):
        if rng.random() < 0.4:
            alive[number] = (k, int(rng.integers(1, 25)), rng.random() < 0.7)
            number += 1
        over = [t for t, (start, length, _) in alive.items() if k - start >= length]
        passes = [replace(PASS, track=t, smoothed={10 * n: 20.0 + n for n in range(
            alive[t][0], k, 2)}) for t in over if alive[t][2]]
        for track in over:
            del alive[track]
        updates = [replace(UPDATE, stamp_ns=10 * k, track=t, speed_mps=float(rng.uniform(9, 30)))
                   for t in sorted(alive, reverse=True) if rng.random() < 0.9]
        steps.append((updates, passes, set(alive)))
    ended = [replace(PASS, track=t) for t, (_, _, vehicle) in alive.items() if vehicle]
    return [*steps, ([], ended, set())]


@pytest.mark.parametrize('seed', range(5))
def test_rows_equal_those_of_the_table_written_at_once(tmp_path, seed):
    steps = drive(np.random.default_rng(seed), 300)
    vehicles = {p.track for _, passes, _ in steps for p in passes}
    most = 0
    with TrackRows(tmp_path) as rows:
        for step in steps:
            rows.add(*step)
            most = max(most, rows.waiting)
        assert os.listdir(tmp_path) == []  # a killed process leaves nothing
        rows.save(tmp_path / 'tracks.csv')
    assert (tmp_path / 'tracks.csv').read_text() == tracks_csv(
        [u for updates, _, _ in steps for u in updates if u.track in vehicles],
        [p for _, passes, _ in steps for p in passes])
    # No row waits longer than the longest track: 25 pairs, with a limited number of vehicles.
    assert most <= 25 * max(len(tracks) for _, _, tracks in steps) * 2


def test_run_without_vehicles_has_a_table_without_rows(tmp_path):
    with TrackRows(tmp_path / 'new') as rows:
        rows.add([UPDATE], [], set())
        rows.save(tmp_path / 'tracks.csv')
    assert (tmp_path / 'tracks.csv').read_text() == tracks_csv([], [])
