# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Tiny bags of every kind: written, read, compared; and every kind of fault."""
from concurrent.futures import CancelledError
import hashlib
import io
import logging
from pathlib import Path
import shutil

import numpy as np
import pytest

from stereo_speed.core.errors import BagError, CalibrationError
from stereo_speed.io.bags import StereoBag

KINDS = ['mcap', 'sqlite', 'ros1']


def make_of(bags, kind):
    return bags.ros1 if kind == 'ros1' else bags.ros2


@pytest.fixture()
def write(bags, tmp_path):
    """Write rows, or the usual stream, as a bag of some kind."""
    def _write(rows=None, kind='mcap', name='bag'):
        make = make_of(bags, kind)
        return bags.write(tmp_path / name, rows or bags.recording(make), make, kind)
    return _write


def opened(path, **options):
    with StereoBag(path, **options) as bag:
        return bag, list(bag.pairs())


@pytest.mark.parametrize('kind', KINDS)
def test_round_trip(bags, write, kind):
    bag, pairs = opened(write(kind=kind))
    assert bag.pair_count == len(pairs) == 3
    assert bag.rig.baseline_m == pytest.approx(0.5)
    for i, pair in enumerate(pairs):
        assert pair.index == i
        assert pair.stamp_ns == pair.right_stamp_ns == bags.START_NS + i * bags.STEP_NS
        np.testing.assert_array_equal(pair.left, bags.picture(2 * i))
        np.testing.assert_array_equal(pair.right, bags.picture(2 * i + 1))
    assert bag.pairing == {'pairs': 3, 'tolerance_ns': 0, 'method': 'exact',
                           'unpaired_left': 0, 'unpaired_right': 0}


@pytest.mark.parametrize('kind', KINDS)
def test_compressed_round_trip(bags, write, kind):
    make = make_of(bags, kind)
    rows = [(topic + '/compressed' * topic.endswith('raw'), msg, log) for topic, msg, log in
            bags.recording(make, image=lambda t, seed: make.compressed(
                t, bags.picture(seed, dtype=np.uint16), 'png', '16UC1; png compressed'))]
    _, pairs = opened(write(rows, kind))
    np.testing.assert_array_equal(pairs[2].right, bags.picture(5, dtype=np.uint16))


@pytest.mark.parametrize('kind', ['mcap', 'sqlite'])
def test_bare_file(write, kind):
    folder = write(kind=kind)
    file = next(p for p in folder.iterdir() if p.suffix in ('.mcap', '.db3'))
    (folder / 'metadata.yaml').unlink()
    assert len(opened(file)[1]) == 3


def test_receive_time_is_ignored(bags, write):
    """All left messages are recorded before the right ones, with the sides in an absurd order."""
    rows = bags.recording(bags.ros2)
    rows = sorted(rows, key=lambda r: 'right' in r[0])
    rows = [(topic, msg, 7 + i) for i, (topic, msg, _) in enumerate(rows)]
    _, pairs = opened(write(rows))
    assert [p.stamp_ns - bags.START_NS for p in pairs] == [0, 200_000_000, 400_000_000]
    np.testing.assert_array_equal(pairs[1].right, bags.picture(3))


def test_offset_stamps_pair_with_the_nearest_and_this_is_reported(bags, write, caplog):
    path = write(bags.recording(bags.ros2, offset_ns=300_000))
    with caplog.at_level(logging.INFO):
        bag, pairs = opened(path)
    assert [p.right_stamp_ns - p.stamp_ns for p in pairs] == [300_000] * 3
    assert bag.tolerance_ns == 5_000_000
    assert bag.pairing['method'] == 'nearest'
    assert [(r.levelname, 'nearest within 5000000 ns' in r.message)
            for r in caplog.records] == [('WARNING', True)]


def test_given_tolerance_is_used(bags, write):
    path = write(bags.recording(bags.ros2, offset_ns=300_000))
    with StereoBag(path, tolerance_ns=0) as bag:
        with pytest.raises(BagError, match='pairs: found none among 3 left and 3 right images, '
                                           'wanted header stamps that agree within 0 ns'):
            bag.pairs()
    assert len(opened(path, tolerance_ns=300_000)[1]) == 3
    far = write(bags.recording(bags.ros2, offset_ns=20_000_000), name='far')
    with StereoBag(far) as bag:
        with pytest.raises(BagError, match='within 5000000 ns'):
            bag.pairs()
    assert len(opened(far, tolerance_ns=20_000_000)[1]) == 3


def test_lost_images_are_counted(bags, write):
    rows = bags.recording(bags.ros2, count=5)
    images = [i for i, row in enumerate(rows) if row[0].endswith('image_raw')]
    for i in sorted((images[0], images[2], images[5]), reverse=True):  # L0, L1, R2
        del rows[i]
    bag, pairs = opened(write(rows))
    assert [p.stamp_ns - bags.START_NS for p in pairs] == [600_000_000, 800_000_000]
    assert (bag.unpaired_left, bag.unpaired_right) == (1, 2)


def test_messages_in_recorded_order(bags, write):
    with StereoBag(write()) as bag:
        messages = list(bag.messages())
    assert len(messages) == 12
    assert [(m.side, m.kind) for m in messages[:4]] == [
        ('left', 'camera_info'), ('left', 'image'), ('right', 'camera_info'), ('right', 'image')]
    assert messages[1].topic == '/stereo/left/image_raw'
    assert messages[1].msgtype == 'sensor_msgs/msg/Image'
    assert messages[1].stamp_ns == bags.START_NS
    assert [m.log_time_ns for m in messages] == sorted(m.log_time_ns for m in messages)


def test_input_hash_is_that_of_the_bytes(write, tmp_path):
    folder = write()
    first = StereoBag(folder).input_hash()
    moved = shutil.copytree(folder, tmp_path / 'moved')
    assert StereoBag(moved).input_hash() == first
    file = moved / 'bag.mcap'
    assert StereoBag(file).input_hash() == hashlib.sha256(file.read_bytes()).hexdigest()
    file.write_bytes(file.read_bytes() + b'x')
    assert StereoBag(moved).input_hash() != first


def test_hash_of_a_file_that_cannot_be_read_fails_each_time(write):
    folder = write()
    bag = StereoBag(folder)
    shutil.rmtree(folder)
    for _ in range(2):  # the second call must not wait for the first
        with pytest.raises(FileNotFoundError):
            bag.input_hash()


def test_hash_in_a_thread_is_the_same_and_ends_with_the_bag(write, monkeypatch):
    folder = write()
    with StereoBag(folder) as bag:
        bag.hash_ahead()
        assert bag.input_hash() == StereoBag(folder).input_hash()
    assert bag.input_hash() == StereoBag(folder).input_hash()

    class Endless(io.BytesIO):
        """Never comes to its end."""

        def read(self, size=-1):
            return bytes(size)
    with StereoBag(folder) as bag:
        monkeypatch.setattr(Path, 'open', lambda *_: Endless())
        bag.hash_ahead()
    with pytest.raises(CancelledError, match='no longer wanted'):
        bag.input_hash()


def refused(path, told, error=BagError, **options):
    """Check that the message is one line that names the path."""
    with pytest.raises(error, match=told) as caught:
        opened(path, **options)
    assert '\n' not in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_missing_bag(tmp_path):
    refused(tmp_path / 'none', 'bag: found no such file or folder, wanted a rosbag2 folder')


def test_other_file_type(tmp_path):
    path = tmp_path / 'a.txt'
    path.write_text('hello')
    refused(path, "found a file ending in '.txt'")


def test_folder_without_metadata(write):
    folder = write()
    (folder / 'metadata.yaml').unlink()
    refused(folder, 'metadata.yaml: found none among bag.mcap, wanted a rosbag2 folder')


@pytest.mark.parametrize('text', ['', 'a: [', 'rosbag2_bagfile_information: {version: 9}'])
def test_damaged_metadata(write, text):
    folder = write()
    (folder / 'metadata.yaml').write_text(text)
    refused(folder, 'file: found .*wanted a whole, readable bag')


@pytest.mark.parametrize('share', [0, 0.001, 0.1, 0.5, 0.9, 0.999])
@pytest.mark.parametrize('kind', KINDS)
def test_truncated(write, kind, share):
    path = write(kind=kind)
    file = path if path.is_file() else next(
        p for p in path.iterdir() if p.suffix in ('.mcap', '.db3'))
    data = file.read_bytes()
    file.write_bytes(data[:int(share * len(data))])
    refused(path, 'wanted')
    if file != path:
        refused(file, 'wanted')


@pytest.mark.parametrize('kind', KINDS)
def test_overwritten_bytes_never_give_a_traceback(bags, write, kind):
    """With noise anywhere in the file there is one line, or the bag is read."""
    path = write(kind=kind)
    file = path if path.is_file() else next(
        p for p in path.iterdir() if p.suffix in ('.mcap', '.db3'))
    data = file.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(25):
        noisy = bytearray(data)
        start = int(rng.integers(len(data)))
        noisy[start:start + 40] = rng.bytes(len(noisy[start:start + 40]))
        file.write_bytes(noisy)
        try:
            opened(path)
        except (BagError, CalibrationError) as error:
            assert '\n' not in str(error)


def test_messages_missing_from_the_file(bags, write):
    """The metadata claim more messages than the file has."""
    folder = write(bags.recording(bags.ros2, count=4))
    short = write(bags.recording(bags.ros2, count=3), name='short')
    shutil.copy(short / 'short.mcap', folder / 'bag.mcap')
    refused(folder, 'messages: found 12 of 16')


def test_one_side_missing(bags, write):
    rows = [r for r in bags.recording(bags.ros2) if r[0] != '/stereo/right/image_raw']
    refused(write(rows), r'right image topic: found /stereo/left/camera_info \(CameraInfo\), '
                         r'/stereo/left/image_raw \(Image\), .*--right TOPIC')


def test_no_calibration(bags, write):
    rows = [r for r in bags.recording(bags.ros2) if not r[0].endswith('info')]
    refused(write(rows), 'left camera_info: found')


def test_uncalibrated(bags, write):
    rows = [(t, bags.ros2.info(bags.START_NS, 'left', k=np.zeros(9)), log)
            if t == '/stereo/left/camera_info' else (t, m, log)
            for t, m, log in bags.recording(bags.ros2)]
    refused(write(rows), r'left: CameraInfo K: .*\(not calibrated\)', CalibrationError)


def test_calibration_changes(bags, write):
    rows = bags.recording(bags.ros2)
    rows[-2] = (rows[-2][0], bags.ros2.info(bags.START_NS, 'right', d=np.full(5, 0.1)),
                rows[-2][2])
    refused(write(rows), 'camera_info: calibration: found a different one at')


def test_image_size(bags, write):
    rows = bags.recording(bags.ros2, image=lambda stamp, seed: bags.ros2.image(
        stamp, bags.picture(seed, (12, 17))))
    refused(write(rows), '/stereo/left/image_raw at .* image size: found 17x12 px, wanted 16x12',
            CalibrationError)


def test_stamps_out_of_order(bags, write):
    rows = bags.recording(bags.ros2)
    rows[-1], rows[3] = (*rows[-1][:1], rows[3][1], rows[-1][2]), \
        (*rows[3][:1], rows[-1][1], rows[3][2])
    refused(write(rows), '/stereo/right/image_raw: header stamps out of order: found '
                         '1700000000200000000 ns after 1700000000400000000 ns')


def test_stamps_never_set(bags, write):
    rows = bags.recording(bags.ros2, image=lambda _, seed: bags.ros2.image(0, bags.picture(seed)))
    refused(write(rows), 'header stamps: found 0 ns in all 3 images, wanted the time each')


def test_undecodable_image(bags, write):
    def broken(stamp, seed):
        msg = bags.ros2.compressed(stamp, bags.picture(seed))
        msg.data = msg.data[:len(msg.data) // 2] if seed == 3 else msg.data
        return msg
    path = write(bags.recording(bags.ros2, image=broken))
    refused(path, '/stereo/right/image_raw at 1700000000200000000 ns: compressed image: found')


def test_depth_differs_between_sides(bags, write):
    rows = bags.recording(bags.ros2, image=lambda stamp, seed: bags.ros2.image(
        stamp, bags.picture(seed, dtype=np.uint16 if seed % 2 else np.uint8),
        'mono16' if seed % 2 else 'mono8'))
    refused(write(rows), 'bits per pixel: found uint8 left and uint16 right')
