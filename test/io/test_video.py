# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A video reads the same as a folder, a file and bags; unreadable ones are named."""
import cv2
import numpy as np
import pytest

from stereo_speed.core.errors import BagError, InputError
from stereo_speed.io.recording import hash_files
from stereo_speed.io.video import frames_missing, image_files, is_bag, read_frames
from stereo_speed.io.video_writer import VideoWriter

COUNT = 12


@pytest.fixture()
def frames(bags):
    """Return smooth images of different colours; JPEG hardly changes smooth ones."""
    images = []
    for i in range(COUNT):
        rough = bags.picture(i, (48, 64, 3)).astype(np.float32)
        smooth = cv2.GaussianBlur(rough, (0, 0), 6) + [4 * i, 0, -4 * i]
        images.append(np.clip(smooth, 0, 255).astype(np.uint8))
    return images


def as_folder(path, frames, name='frame_{}.png'):
    path.mkdir()
    for number, image in enumerate(frames, 1):
        assert cv2.imwrite(str(path / name.format(number)), image)
    return path


def as_bag(bags, path, frames, kind='mcap', topic='/camera/image_raw', compressed=False):
    make = bags.ros1 if kind == 'ros1' else bags.ros2
    rows = []
    for i, image in enumerate(frames):
        stamp = bags.START_NS + i * bags.STEP_NS
        msg = make.compressed(stamp, image, 'png', 'bgr8; png compressed bgr8') if compressed \
            else make.image(stamp, image[..., ::-1], 'rgb8')
        rows.append((topic, msg, 5000 + i))
    return bags.write(path, rows, make, kind)


def as_file(path, frames):
    writer = VideoWriter(path, frames[0].shape)
    for image in frames:
        writer.write(image)
    writer.keep()
    writer.close()
    return path


def test_folder_file_and_bags_give_the_same_frames(tmp_path, bags, frames):
    exact = [as_folder(tmp_path / 'folder', frames)]
    exact += [as_bag(bags, tmp_path / kind, frames, kind) for kind in ('mcap', 'sqlite3', 'ros1')]
    exact[-1] = tmp_path / 'ros1.bag'
    exact.append(as_bag(bags, tmp_path / 'packed', frames, topic='/camera/image/compressed',
                        compressed=True))
    exact.append(next((tmp_path / 'mcap').glob('*.mcap')))
    for path in exact:
        found = list(read_frames(path))
        assert [f.number for f in found] == list(range(1, COUNT + 1)), path
        np.testing.assert_array_equal([f.image for f in found], frames)
        stamps = [f.stamp_ns for f in found]
        assert stamps == ([bags.START_NS + i * bags.STEP_NS for i in range(COUNT)]
                          if is_bag(path) else [None] * COUNT)
    found = list(read_frames(as_file(tmp_path / 'video.avi', frames)))
    assert [f.number for f in found] == list(range(1, COUNT + 1))
    error = np.abs(np.array([f.image for f in found], int) - frames)
    assert error.max() < 16 and error.mean() < 3
    # and no frame is mistaken for its neighbour
    gaps = np.array([[np.abs(f.image.astype(int) - g).mean() for g in frames] for f in found])
    np.testing.assert_array_equal(gaps.argmin(axis=1), np.arange(COUNT))


def test_truncated_file_lacks_its_last_frames(tmp_path, bags, frames):
    path = as_file(tmp_path / 'video.avi', frames)
    assert [frames_missing(path, n) for n in (COUNT + 1, COUNT, COUNT - 1, COUNT - 2)] == [
        0, 0, 0, 2]  # a difference of one is within the accuracy of files
    data = path.read_bytes()
    path.write_bytes(data[:int(0.8 * len(data))])
    read = len(list(read_frames(path)))
    assert 0 < read < COUNT - 1 and frames_missing(path, read) == COUNT - read
    # these do not state it
    assert frames_missing(as_folder(tmp_path / 'folder', frames), 1) == 0
    assert frames_missing(as_bag(bags, tmp_path / 'mcap', frames), 1) == 0


def test_folder_is_in_natural_order(tmp_path, frames):
    folder = tmp_path / 'v'
    folder.mkdir()
    names = ['a2.png', 'a10.PNG', 'a9.bmp', 'b1.png', '10.png', '9.png', 'a2-11.png', 'a2-3.png',
             '1²2.png']
    for name in names:
        cv2.imwrite(str(folder / 'x.png'), frames[0])
        (folder / 'x.png').rename(folder / name)
    (folder / 'notes.txt').write_text('no image')
    assert [p.name for p in image_files(folder)] == [
        '1²2.png', '9.png', '10.png', 'a2-3.png', 'a2-11.png', 'a2.png', 'a9.bmp', 'a10.PNG',
        'b1.png']


def test_grey_images_have_three_channels(tmp_path, bags):
    folder = as_folder(tmp_path / 'v', [bags.picture(1)])
    frame, = read_frames(folder)
    np.testing.assert_array_equal(frame.image, np.repeat(bags.picture(1)[..., None], 3, -1))


def test_topic_of_a_bag(tmp_path, bags, frames):
    make, rows = bags.ros2, []
    for i, image in enumerate(frames[:2]):
        rows += [('/a/image_raw', make.image(i, image, 'bgr8'), i),
                 ('/b/image_raw', make.image(i, image[::-1], 'bgr8'), i),
                 ('/b/image_raw/compressed', make.compressed(i, image, 'png', 'bgr8'), i),
                 ('/b/camera_info', make.info(i, 'left'), i)]
    both = bags.write(tmp_path / 'both', rows, make)
    for topic in ('/b/image_raw', 'b/image_raw'):
        np.testing.assert_array_equal(next(read_frames(both, topic)).image, frames[0][::-1])
    np.testing.assert_array_equal(
        next(read_frames(both, '/b/image_raw/compressed')).image, frames[0])
    with pytest.raises(BagError, match=r'both: image topic: found /a/image_raw, /b/image_raw, '
                                       r'/b/image_raw/compressed, wanted one only, or --topic'):
        next(read_frames(both))
    with pytest.raises(BagError, match=r'both: --topic /c: found /a/image_raw, .*a topic of ima'):
        next(read_frames(both, '/c'))
    one = bags.write(tmp_path / 'one', [r for r in rows if r[0].startswith('/b')], make)
    # raw beside compressed: the raw one is taken
    np.testing.assert_array_equal(next(read_frames(one)).image, frames[0][::-1])
    none = bags.write(tmp_path / 'none', [r for r in rows if 'info' in r[0]], make)
    with pytest.raises(BagError, match='none: image topic: found none'):
        next(read_frames(none))


def test_topic_without_a_bag(tmp_path, frames):
    with pytest.raises(InputError, match='v: --topic: found /a, wanted none: only bags have to'):
        read_frames(as_folder(tmp_path / 'v', frames), '/a')


def test_empty_input(tmp_path):
    with pytest.raises(InputError, match='absent: video: found no such file or folder, wanted a'):
        read_frames(tmp_path / 'absent')
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'text.avi').write_text('no video')
    for name in ('empty', 'text.avi'):
        with pytest.raises(InputError, match=f'{name}: frames: found none that can be decoded'):
            list(read_frames(tmp_path / name))


def test_damaged_image_is_named(tmp_path, frames):
    folder = as_folder(tmp_path / 'v', frames[:3])
    (folder / 'frame_2.png').write_bytes(b'no image')
    (folder / 'frame_3.png').write_bytes(b'')
    stream = read_frames(folder)
    assert next(stream).number == 1
    with pytest.raises(InputError, match=r'frame_2\.png: image: found 8 bytes that cannot be dec'):
        next(stream)
    (folder / 'frame_2.png').unlink()
    with pytest.raises(InputError, match=r'frame_3\.png: image: found 0 bytes that cannot'):
        list(read_frames(folder))


def test_change_of_size_is_refused(tmp_path, bags, frames):
    changed = frames[:2] + [frames[2][:40]]
    paths = [as_folder(tmp_path / 'v', changed), as_bag(bags, tmp_path / 'b', changed)]
    for path in paths:
        with pytest.raises(InputError, match='size of frame 3: found 64x40 px, wanted 64x48 px'):
            list(read_frames(path))


def test_bag_is_recognised_by_its_name_or_content(tmp_path, bags, frames):
    bag = as_bag(bags, tmp_path / 'bag', frames[:1])
    folder = as_folder(tmp_path / 'folder', frames[:1])
    assert is_bag(bag) and not is_bag(folder)
    assert is_bag(next(bag.glob('*.mcap'))) and not is_bag(tmp_path / 'film.avi')
    (bag / 'metadata.yaml').unlink()
    assert is_bag(bag)
    with pytest.raises(BagError, match=r'metadata\.yaml: found none among'):
        list(read_frames(bag))


def test_hash_is_that_of_the_content(tmp_path, frames):
    one, two = as_folder(tmp_path / 'a', frames[:2]), as_folder(tmp_path / 'b', frames[:2])
    assert hash_files(one) == hash_files(two)
    cv2.imwrite(str(two / 'frame_2.png'), frames[3])
    assert hash_files(one) != hash_files(two)


def test_video_appears_only_when_complete(tmp_path, frames):
    path = tmp_path / 'out.avi'
    path.write_text('older')
    writer = VideoWriter(path, frames[0].shape)
    writer.write(frames[0])
    assert path.read_text() == 'older'
    writer.close()  # given up
    assert [p.name for p in tmp_path.iterdir()] == ['out.avi'] and path.read_text() == 'older'
    as_file(path, frames[:3])
    assert [p.name for p in tmp_path.iterdir()] == ['out.avi']
    assert len(list(read_frames(path))) == 3


def test_unwritable_video(tmp_path, frames):
    with pytest.raises(InputError, match=r'out\.avi: video: found a file that cannot be written'):
        VideoWriter(tmp_path / 'absent' / 'out.avi', frames[0].shape)
