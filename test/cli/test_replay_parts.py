# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A long replay resumes after an interruption, and writes the same files."""
from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from functools import partial
import hashlib
import itertools
import json
import sqlite3

import numpy as np
import pytest
from stereo_speed.cli import replay
from stereo_speed.cli.main import main
from stereo_speed.cli.replay_parts import FOLDER, is_kept
from stereo_speed.io.bags import StereoBag
from stereo_speed.lab.sim.write import write_pairs

STEP_NS = 200_000_000
UNEVEN_NS = 2_500_000  # of every other stamp
QUIET = 8  # pairs of the empty road after each vehicle


@pytest.fixture(scope='module')
def bag(sample, tmp_path_factory):
    """
    Write three vehicles, 12 pairs each, and the empty road after each of them.

    Stamps are uneven and then become even, so that a resumed run has to know the earlier ones.
    """
    with StereoBag(sample / 'bag') as source:
        rig, seen = source.rig, list(source.pairs())
    empty = replace(seen[0], **{side: np.median(
        [getattr(p, side) for p in seen], axis=0).astype(np.uint8) for side in ('left', 'right')})
    stamps = (seen[0].stamp_ns + k * STEP_NS + UNEVEN_NS * (k % 2) * (k < 42)
              for k in itertools.count())
    pairs = [replace(pair, index=k, stamp_ns=ns, right_stamp_ns=ns) for k, (pair, ns) in enumerate(
        zip(3 * (seen + QUIET * [empty]), stamps))]
    return write_pairs(rig, pairs, tmp_path_factory.mktemp('long') / 'made') / 'bag'


@pytest.fixture
def in_parts(monkeypatch):
    """Use short parts."""
    monkeypatch.setattr(replay, 'PART_PAIRS', 10)


def files(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def interrupt(monkeypatch, pairs):
    """Raise a KeyboardInterrupt after some pairs of a run."""
    def some(stream, **_):
        for number, pair in enumerate(stream):
            if number == pairs:
                raise KeyboardInterrupt
            yield pair
    monkeypatch.setattr(replay, 'tqdm', some)


@pytest.mark.slow
def test_interrupted_run_resumes_and_writes_the_same_files(
        bag, sample, tmp_path, in_parts, monkeypatch, capsys):
    def argv(name, *more):
        return ['replay', str(bag), '--site', str(sample / 'site.yaml'), '--out',
                str(tmp_path / name), *more]
    with monkeypatch.context() as patch:
        patch.setattr(replay, 'PART_PAIRS', 1000)
        assert main(argv('as_one')) == 0
    wanted = files(tmp_path / 'as_one')
    assert json.loads(wanted['summary.json'])['passes']['measured'] == 3
    assert not any(name.startswith('.') for name in wanted)

    with monkeypatch.context() as patch:
        interrupt(patch, 50)
        assert main(argv('cut')) == 130
    kept = tmp_path / 'cut' / FOLDER
    assert [p.name for p in (tmp_path / 'cut').iterdir()] == [FOLDER]
    # a line truncated by a kill is not used
    with (kept / 'steps.jsonl').open('a') as steps:
        steps.write('{"!":"dict","v":[["pairs",35')
    with monkeypatch.context() as patch:
        interrupt(patch, 1)  # once more, one pair on
        assert main(argv('cut')) == 130
    capsys.readouterr()

    def full(*_):
        raise OSError(28, 'No space left on device')
    with monkeypatch.context() as patch:
        patch.setattr(replay, 'write_all', full)
        assert main(argv('cut')) == 2
    told, said = capsys.readouterr()
    done = int(told.partition('resuming after ')[2].split()[0])
    assert 32 < done < 50 and 'No space left' in said
    # what was measured is not lost if the files cannot be written
    assert [p.name for p in (tmp_path / 'cut').iterdir()] == [FOLDER]
    assert main(argv('cut')) == 0
    assert int(capsys.readouterr().out.partition('resuming after ')[2].split()[0]) > done
    assert files(tmp_path / 'cut') == wanted

    # the results of a run with other options are not used: all parts are measured
    with monkeypatch.context() as patch:
        interrupt(patch, 25)
        assert main(argv('other', '--seed', '5', '--no-plots')) == 130
    assert '["pairs"' in (tmp_path / 'other' / FOLDER / 'steps.jsonl').read_text()  # a part
    capsys.readouterr()
    assert main(argv('other')) == 0
    assert 'resuming' not in capsys.readouterr().out
    assert files(tmp_path / 'other') == wanted


@pytest.mark.slow
def test_database_has_the_readings_that_do_not_fit_in_memory(bag, sample, tmp_path, monkeypatch):
    monkeypatch.setattr(replay, 'run_pipeline', partial(replay.run_pipeline, most_updates=20))
    assert main(['replay', str(bag), '--site', str(sample / 'site.yaml'), '--no-plots',
                 '--sqlite', '--out', str(tmp_path)]) == 0
    with (tmp_path / 'tracks.csv').open(newline='') as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 30 and len({row['track'] for row in rows}) == 3
    database = sqlite3.connect(tmp_path / 'run.sqlite')
    found = database.execute('SELECT * FROM tracks').fetchall()
    database.close()
    assert found == [
        (int(row['stamp_ns']), f'vehicle_{row["track"]}',
         *(float(row[key]) if row['state'] == 'confirmed' else None
           for key in ('speed_mps', 'speed_std_mps')),
         *(float(row[key]) for key in ('x_m', 'y_m', 'z_m'))) for row in rows]


def test_inputs_are_those_at_the_start(bag, sample, tmp_path, monkeypatch):
    """A file that is edited or removed meanwhile is described as it was."""
    site = tmp_path / 'site.yaml'
    site.write_bytes((sample / 'site.yaml').read_bytes())
    before = hashlib.sha256(site.read_bytes()).hexdigest()

    def first(stream, **_):
        site.unlink()
        return itertools.islice(stream, 2)
    monkeypatch.setattr(replay, 'tqdm', first)
    assert main(['replay', str(bag), '--site', str(site), '--no-plots', '--evidence',
                 '--out', str(tmp_path / 'out')]) == 0
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['input']['site_sha256'] == before


def test_failed_run_leaves_nothing(bag, sample, tmp_path, in_parts, monkeypatch, capsys):
    def fail(stream, **_):
        for number, pair in enumerate(stream):
            if number == 3:
                raise replay.InputError('bag', 'image', 'garbage', 'an image')
            yield pair
    monkeypatch.setattr(replay, 'tqdm', fail)
    out = tmp_path / 'out'
    assert main(['replay', str(bag), '--site', str(sample / 'site.yaml'), '--out', str(out),
                 '--no-plots']) == 2
    assert list(out.iterdir()) == []
    assert capsys.readouterr().err.count('\n') == 1


@pytest.mark.parametrize('option', ['evidence', 'video', 'report'])
def test_runs_with_video_report_or_evidence_are_not_resumed(option):
    options = {'evidence': False, 'video': False, 'report': False}
    assert is_kept(argparse.Namespace(**options))
    assert not is_kept(argparse.Namespace(**{**options, option: True}))
