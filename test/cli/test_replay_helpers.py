# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A replay that has processes help it writes what it would have written alone."""
from __future__ import annotations

from dataclasses import replace
import os
import signal
import sys
import threading
from types import SimpleNamespace

import pytest
from stereo_speed.cli import replay
from stereo_speed.cli.main import main
from stereo_speed.cli.replay_helpers import FEWEST_PAIRS, Helpers
from stereo_speed.io.bags import StereoBag
from stereo_speed.lab.sim.write import write_pairs


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    """Have helpers pay wherever this runs."""
    monkeypatch.setattr(os, 'sched_getaffinity', lambda pid: {0, 1})


def files(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


@pytest.mark.slow
def test_the_same_is_written_with_helpers_without_and_where_they_are_killed(
        sample, tmp_path, monkeypatch, capfd):
    def written(name, helpers):
        monkeypatch.setattr(replay.Helpers, 'of', helpers)
        assert main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'), '--out',
                     str(tmp_path / name), '--no-plots']) == 0
        return files(tmp_path / name)

    def ready(pairs, detector, *, beside):
        helpers = Helpers(True, detector)
        helpers.wait()
        used.append(helpers)
        return helpers

    def dying(pairs, detector, *, beside):
        """Have them killed as soon as a detector is to move to one, and before any pass."""
        helpers = ready(pairs, detector, beside=beside)
        for pid in (helpers.search_pid, helpers.pass_pid):
            os.kill(pid, signal.SIGKILL)
        return helpers
    used = []
    alone = written('alone', lambda *_, beside: Helpers(False, None, ahead=False))
    assert written('read ahead', lambda *_, beside: Helpers(False, None)) == alone
    assert written('helped', ready) == alone
    capfd.readouterr()
    assert written('killed', dying) == alone
    said = capfd.readouterr().err
    assert 'the process that searches for vehicles: ' in said
    assert 'the process that measures passes: ' in said
    assert len(used) == 2
    assert all(helpers.search_pid is helpers.pass_pid is None for helpers in used)


@pytest.fixture(scope='module')
def dense(sample, tmp_path_factory):
    """Write a road on which nothing moves, at 20 pairs a second."""
    with StereoBag(sample / 'bag') as source:
        rig, still = source.rig, next(iter(source.pairs()))
    pairs = [replace(still, index=k, stamp_ns=ns, right_stamp_ns=ns)
             for k, ns in enumerate(range(0, 35 * 50_000_000, 50_000_000))]
    return write_pairs(rig, pairs, tmp_path_factory.mktemp('dense') / 'made') / 'bag'


@pytest.mark.slow
def test_parts_of_dense_pairs_end_where_they_do_without_helpers(
        dense, sample, tmp_path, monkeypatch):
    """When a part is to end the answer of the last search is still under way."""
    class Counted(replay.Parts):
        """Parts that tell after how many pairs they ended."""

        def begin(self, pipeline, so_far):
            ends.append(len(so_far.stamps_ns))
            return super().begin(pipeline, so_far)

    def helpers(pairs, detector, *, beside):
        one = Helpers(helped, detector, ahead=helped)
        one.wait()
        return one
    monkeypatch.setattr(replay, 'Parts', Counted)
    monkeypatch.setattr(replay, 'PART_PAIRS', 10)
    monkeypatch.setattr(replay.Helpers, 'of', helpers)
    told = []
    for helped in (False, True):
        ends, out = [], tmp_path / str(helped)
        assert main(['replay', str(dense), '--site', str(sample / 'site.yaml'), '--out', str(out),
                     '--no-plots']) == 0
        told.append((ends, files(out)))
    assert told[0] == told[1]
    assert ends == [10, 20, 30]


def test_after_an_error_nothing_is_read_ahead_any_more(sample):
    def fail(pair):
        raise ZeroDivisionError
    with StereoBag(sample / 'bag') as bag, pytest.raises(ZeroDivisionError) as kept:
        replay.measure(bag, SimpleNamespace(process=fail), keep_frames=False, read_ahead=True)
    assert kept.tb is not None  # which holds what was under way, as whoever catches it does
    assert not [one.name for one in threading.enumerate() if one.name.startswith('ahead')]


def test_short_bags_and_those_of_many_go_without_processes():
    turn_s = sys.getswitchinterval()
    for pairs, beside in ((FEWEST_PAIRS - 1, True), (10 * FEWEST_PAIRS, False)):
        with Helpers.of(pairs, 'plane_sweep', beside=beside) as helpers:
            assert helpers.later is None and helpers.detect is None
            assert helpers.ahead == beside
            assert (sys.getswitchinterval() < turn_s) == beside
    assert sys.getswitchinterval() == turn_s


def test_other_detectors_and_annotated_fronts_are_searched_for_here():
    for detector in (None, 'boxes'):
        with Helpers(True, detector) as helpers:
            assert helpers.later is not None and helpers.detect is None
    with Helpers(True, 'plane_sweep') as helpers:
        assert helpers.detect is not None and helpers.search_pid is not None
