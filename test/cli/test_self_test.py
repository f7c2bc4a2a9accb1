# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``self-test`` with the sample's known speed, and with a wrong speed."""
from __future__ import annotations

import csv
import shutil

import pytest
from stereo_speed.cli.main import main
from stereo_speed.pipeline.self_test import off_percent


@pytest.fixture()
def stored(sample, tmp_path):
    """Return a function that stores the sample with its true speeds multiplied by a factor."""
    def store(factor):
        with (sample / 'truth.csv').open(newline='') as file:
            rows = list(csv.DictReader(file))
        folder = tmp_path / str(factor)
        shutil.copytree(sample, folder)
        with (folder / 'truth.csv').open('w', newline='') as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows({**row, 'speed': float(row['speed']) * factor} for row in rows)
        return folder
    return store


def test_sample_passes(sample, capsys):
    assert main(['self-test', str(sample)]) == 0
    line = capsys.readouterr().out
    assert line.startswith('self-test passed: +0.')
    assert 0.0 < off_percent(line) < 1.0


def test_deviation_of_more_than_one_percent_fails(stored, capsys):
    assert main(['self-test', str(stored(1.015))]) == 1
    line = capsys.readouterr().out
    assert 'self-test failed: the stored pass of' in line and off_percent(line) is None


def test_folder_without_a_stored_pass_is_one_line(tmp_path, capsys):
    assert main(['self-test', str(tmp_path)]) == 2
    assert capsys.readouterr().err.count('\n') == 1
