# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A replay with helper processes writes the same files as one without."""
from __future__ import annotations

from dataclasses import replace
import os
import signal
import sys
import threading
from types import SimpleNamespace

import pytest
from stereo_speed.cli import replay, replay_helpers
from stereo_speed.cli.main import main
from stereo_speed.cli.replay_helpers import FEWEST_PAIRS, FEWEST_WITHOUT_FORK, Helpers
from stereo_speed.detection.beside import SearchProcess
from stereo_speed.io.bags import StereoBag
from stereo_speed.lab.sim.write import write_pairs
from stereo_speed.pipeline.pass_process import PassProcess


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    """Make helpers worthwhile on any machine."""
    monkeypatch.setattr(os, 'sched_getaffinity', lambda pid: {0, 1})


class Ready(SearchProcess):
    """Searches from the first pair on: asking whether it is ready waits until it is."""

    made = []

    def __init__(self, *settings, **more):
        """Register itself."""
        super().__init__(*settings, **more)
        self.made.append(self)

    def is_ready(self):
        """Wait until it is ready."""
        self.wait()
        return True


class Dying(Ready):
    """Is killed when a detector is about to move to it."""

    def is_ready(self):
        """Wait until it is ready, and kill it."""
        super().is_ready()
        os.kill(self.process.pid, signal.SIGKILL)
        return True


class Patient(PassProcess):
    """Waits long enough for an answer on a busy machine."""

    def __init__(self, answer_s=120.0, **more):
        """Wait for that time."""
        super().__init__(answer_s, **more)


class DyingBeforePasses(Patient):
    """Is killed before it can measure a pass."""

    def wait(self):
        """Wait until it is ready, and kill it."""
        super().wait()
        Ready.made.append(self)
        os.kill(self.process.pid, signal.SIGKILL)


def files(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


@pytest.mark.slow
def test_files_do_not_depend_on_helpers_or_their_death(sample, tmp_path, monkeypatch, capfd):
    def written(name, helpers, search=Ready, passes=Patient):
        monkeypatch.setattr(replay.Helpers, 'of', lambda *_, beside: helpers())
        monkeypatch.setattr(replay_helpers, 'SearchProcess', search)
        monkeypatch.setattr(replay_helpers, 'PassProcess', passes)
        monkeypatch.setattr(Ready, 'made', [])
        assert main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'), '--out',
                     str(tmp_path / name), '--no-plots']) == 0
        ended = [one.process.poll() for one in Ready.made]
        assert None not in ended
        return files(tmp_path / name), ended

    def both():
        return Helpers(True, 'plane_sweep')
    alone, ended = written('alone', lambda: Helpers(False, None, ahead=False))
    assert not ended
    assert written('read ahead', lambda: Helpers(False, None)) == (alone, [])
    capfd.readouterr()
    helped, ended = written('helped', both)
    # One that does not end within two seconds on a busy machine is killed in the end, too.
    assert helped == alone and ended in ([0], [-signal.SIGKILL])
    assert ' process: ' not in capfd.readouterr().err
    assert written('killed', both, Dying, DyingBeforePasses) == (alone, [-signal.SIGKILL] * 2)
    said = capfd.readouterr().err
    assert 'search process: ' in said
    assert 'pass process: ' in said


@pytest.fixture(scope='module')
def dense(sample, tmp_path_factory):
    """Write a road on which nothing moves, at 20 pairs/s."""
    with StereoBag(sample / 'bag') as source:
        rig, still = source.rig, next(iter(source.pairs()))
    pairs = [replace(still, index=k, stamp_ns=ns, right_stamp_ns=ns)
             for k, ns in enumerate(range(0, 35 * 50_000_000, 50_000_000))]
    return write_pairs(rig, pairs, tmp_path_factory.mktemp('dense') / 'made') / 'bag'


@pytest.mark.slow
def test_parts_of_dense_pairs_end_at_the_same_pairs_with_helpers(
        dense, sample, tmp_path, monkeypatch):
    """When a part could end, the answer of the last search is still pending."""
    class Counted(replay.Parts):
        """Parts that report after how many pairs they ended."""

        def begin(self, pipeline, so_far):
            ends.append(len(so_far.stamps_ns))
            return super().begin(pipeline, so_far)

    def helpers(pairs, detector, *, beside):
        return Helpers(helped, detector, ahead=helped)
    monkeypatch.setattr(replay_helpers, 'SearchProcess', Ready)
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


def test_nothing_more_is_read_ahead_after_an_error(sample):
    def fail(pair):
        raise ZeroDivisionError
    with StereoBag(sample / 'bag') as bag, pytest.raises(ZeroDivisionError) as kept:
        replay.measure(bag, SimpleNamespace(process=fail), keep_frames=False, read_ahead=True)
    assert kept.tb is not None  # as a handler that holds the exception would
    assert not [one.name for one in threading.enumerate() if one.name.startswith('ahead')]


@pytest.mark.parametrize('forks, fewest', [(True, FEWEST_PAIRS), (False, FEWEST_WITHOUT_FORK)])
def test_short_bags_and_batches_of_bags_use_no_helpers(forks, fewest, monkeypatch):
    monkeypatch.setattr(replay_helpers, 'can_fork', lambda: forks)
    turn_s = sys.getswitchinterval()
    for pairs, beside in ((fewest - 1, True), (10 * fewest, False)):
        with Helpers.of(pairs, 'plane_sweep', beside=beside) as helpers:
            assert helpers.later is None and helpers.detect is None
            assert helpers.ahead == beside
            assert (sys.getswitchinterval() < turn_s) == beside
    assert sys.getswitchinterval() == turn_s

    class Asked(Helpers):
        """Reports whether processes were requested."""

        def __init__(self, processes, *_, **more):
            asked.append(processes)
    asked = []
    Asked.of(fewest, 'plane_sweep', beside=True)
    assert asked == [True]


def test_other_detectors_and_annotated_fronts_are_processed_here():
    for detector in (None, 'boxes'):
        with Helpers(True, detector) as helpers:
            assert helpers.later is not None and helpers.detect is None
    with Helpers(True, 'plane_sweep') as helpers:
        assert helpers.detect is not None
