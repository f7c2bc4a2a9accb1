# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""One record of the sample's vehicle, and small ones made of it."""
from __future__ import annotations

from dataclasses import replace
import json
from pathlib import Path
import shutil
from typing import NamedTuple

import pytest
from stereo_speed.core.passes import PassResult
from stereo_speed.enforcement.config import EnforcementConfig
from stereo_speed.enforcement.fingerprint import Approved, sha256
from stereo_speed.enforcement.instrument import Instrument
from stereo_speed.enforcement.record import Setting
from stereo_speed.enforcement.recorder import EvidenceRecorder
from stereo_speed.enforcement.ring import ImageRing
from stereo_speed.enforcement.store import EvidenceStore
from stereo_speed.io.bags import StereoBag
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.pipeline.run import run
from stereo_speed.site.file import load_site

SAMPLE = Path(__file__).resolve().parents[2] / 'sample' / 'straight55'
NAME = 'run-000000'


class Sample(NamedTuple):
    """The sample, measured once, with all its images."""

    setting: Setting
    ring: ImageRing
    result: PassResult

    def recorder(self, folder, config=EnforcementConfig(), approved=Approved()):
        """Return a recorder that writes to a folder."""
        setting = replace(self.setting, config=config, approved=approved)
        return EvidenceRecorder(EvidenceStore(folder), setting, self.ring)


@pytest.fixture(scope='session')
def sample():
    """Measure the sample and keep its images as received."""
    ring = ImageRing(1 << 30, 10 ** 12)

    def keep(pair, left, right):
        ring.add('left', pair.stamp_ns, left)
        ring.add('right', pair.right_stamp_ns, right)
    with StereoBag(SAMPLE / 'bag') as bag:
        place = MeasuringSite.of(load_site(SAMPLE / 'site.yaml'), bag.rig)
        bag.watcher = keep
        result, = run(place.pipeline(PipelineConfig()), bag.pairs()).passes
    setting = Setting(Instrument.of('run', place, PipelineConfig()), place, EnforcementConfig(),
                      Approved(), 'header stamps')
    return Sample(setting, ring, result)


@pytest.fixture(scope='session')
def written(sample, tmp_path_factory):
    """Write the record of the sample's vehicle into a folder that no test may change."""
    folder = tmp_path_factory.mktemp('written') / 'evidence'
    recorder = sample.recorder(folder)
    assert recorder.offer(NAME, sample.result).anew
    recorder.store.close()
    return folder


@pytest.fixture
def evidence(written, tmp_path):
    """Return a copy of the record that a test may damage."""
    return Path(shutil.copytree(written, tmp_path / 'evidence'))


@pytest.fixture
def small(written):
    """Return a maker of small records: files and the bytes of ``record.json``."""
    record = json.loads((written / NAME / 'record.json').read_text())

    def make(name, number, size=40, last_ns=record['time']['last_stamp_ns']):
        files = {'a.txt': b'a' * size, 'sub/b.bin': bytes(range(size))}
        listed = {key: {'sha256': sha256(value), 'bytes': len(value)}
                  for key, value in files.items()}
        data = {**record, 'id': name, 'number': number, 'files': listed,
                'time': {**record['time'], 'last_stamp_ns': last_ns}}
        return files, json.dumps(data).encode()
    return make
