# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Small bags made from the sample, whole and damaged."""
from __future__ import annotations

from pathlib import Path
from typing import Any, Callable, Optional

import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
import yaml

SAMPLE = Path(__file__).resolve().parents[2] / 'sample' / 'straight55'
PAIRS = 4

Change = Callable[[str, int, Any], Optional[Any]]


def _same(topic: str, number: int, msg: Any) -> Any:
    return msg


@pytest.fixture(scope='session')
def sample() -> Path:
    """Folder of the sample: bag, site.yaml, init.yaml, truth.csv."""
    return SAMPLE


@pytest.fixture(scope='session')
def rewrite() -> Callable[..., Path]:
    """
    Give the function that rewrites the first pairs of the sample's bag.

    Its ``change(topic, number, msg)`` gives the message to write, or None to leave it out.
    """
    def write(folder: Path, change: Change = _same, pairs: int = PAIRS) -> Path:
        with AnyReader([SAMPLE / 'bag']) as reader, \
                Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            out, numbers = {}, dict.fromkeys((c.topic for c in reader.connections), 0)
            for source, log_time_ns, data in reader.messages():
                number = numbers[source.topic]
                numbers[source.topic] += 1
                msg = reader.deserialize(data, source.msgtype)
                msg = change(source.topic, number, msg) if number < pairs else None
                if msg is None:
                    continue
                if source.topic not in out:
                    out[source.topic] = writer.add_connection(
                        source.topic, source.msgtype, typestore=reader.typestore)
                writer.write(out[source.topic], log_time_ns,
                             reader.typestore.serialize_cdr(msg, source.msgtype))
        return folder
    return write


@pytest.fixture(scope='session')
def short_bag(rewrite, tmp_path_factory) -> Path:
    """Give the first pairs of the sample."""
    return rewrite(tmp_path_factory.mktemp('short') / 'bag')


@pytest.fixture
def edited(tmp_path) -> Callable[[str, Callable[[dict], None]], Path]:
    """Give the function that edits a copy of one of the sample's YAML files."""
    def edit(name: str, change: Callable[[dict], None]) -> Path:
        data = yaml.safe_load((SAMPLE / name).read_text())
        change(data)
        path = tmp_path / name
        path.write_text(yaml.safe_dump(data))
        return path
    return edit
