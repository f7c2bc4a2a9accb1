# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Bad input: exit status 2, one line with file and field, and no output that looks complete."""
from __future__ import annotations

import math
from pathlib import Path
import re
import subprocess
import sys

import pytest
from stereo_speed.cli.main import main
import yaml

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def refused(capsys, sample, short_bag, tmp_path):
    """Return a function that runs ``replay`` in-process, checks its exit and returns the line."""
    def run(*more: str, bag: Path = short_bag, site: Path = sample / 'site.yaml',
            init: Path | None = sample / 'init.yaml') -> str:
        out = tmp_path / 'out'
        argv = ['replay', str(bag), '--site', str(site), '--out', str(out), '--no-plots', *more]
        argv += [] if init is None else ['--init', str(init)]
        assert main(argv) == 2
        captured = capsys.readouterr()
        assert captured.err.startswith('error: ')
        assert captured.err.count('\n') == 1
        assert captured.err.endswith('\n')
        assert 'Traceback' not in captured.out + captured.err
        assert [path for path in out.rglob('*') if path.is_file()] == []
        return captured.err
    return run


def assert_names(line: str, *parts: object) -> None:
    """Check that the line contains each part."""
    for part in parts:
        assert str(part) in line


def replaced(msg, field: str, value):
    """Return the message with a field replaced; works for frozen messages, too."""
    object.__setattr__(msg, field, value)
    return msg


def test_truncated_bag(refused, short_bag, tmp_path):
    bag = tmp_path / 'cut'
    bag.mkdir()
    for path in short_bag.iterdir():
        data = path.read_bytes()
        cut = len(data) * 2 // 3 if path.suffix == '.mcap' else len(data)
        (bag / path.name).write_bytes(data[:cut])
    assert_names(refused(bag=bag), bag)


def test_no_bag(refused, tmp_path):
    assert_names(refused(bag=tmp_path / 'nowhere'), tmp_path / 'nowhere')


def test_folder_without_a_bag(refused, tmp_path):
    (tmp_path / 'empty').mkdir()
    assert_names(refused(bag=tmp_path / 'empty'), tmp_path / 'empty')


def test_no_image_topics(refused, rewrite, tmp_path):
    bag = rewrite(tmp_path / 'infos', lambda t, n, m: m if t.endswith('info') else None)
    assert_names(refused(bag=bag), bag, 'image')


def test_no_camera_info(refused, rewrite, tmp_path):
    bag = rewrite(tmp_path / 'images', lambda t, n, m: None if t.endswith('info') else m)
    assert_names(refused(bag=bag), bag, 'camera_info')


@pytest.mark.parametrize('side', ['left', 'right'])
def test_one_side_missing(refused, rewrite, tmp_path, side):
    bag = rewrite(tmp_path / 'half', lambda t, n, m: None if f'/{side}/image' in t else m)
    assert_names(refused(bag=bag), bag, side)


def test_topic_missing_from_the_bag(refused, short_bag):
    assert_names(refused('--left', '/nothing'), short_bag, '/nothing')


def test_calibration_of_zeros(refused, rewrite, tmp_path):
    def blank(topic, number, msg):
        if not topic.endswith('info'):
            return msg
        for field in 'dkrp':
            value = getattr(msg, field)
            msg = replaced(msg, field, value * 0)
        return msg
    bag = rewrite(tmp_path / 'zeros', blank)
    assert re.search(r'\bk\b', refused(bag=bag), re.IGNORECASE)


def test_image_size_differs_from_calibration(refused, rewrite, tmp_path):
    def wider(topic, number, msg):
        return replaced(msg, 'width', 2048) if topic.endswith('info') else msg
    bag = rewrite(tmp_path / 'wide', wider)
    assert_names(refused(bag=bag), bag, '1024x768', '2048x768')


def test_stamps_out_of_order(refused, rewrite, tmp_path):
    def swapped(topic, number, msg):
        if number in (1, 2):
            # on both sides, so that the images still pair
            replaced(msg.header.stamp, 'nanosec', 400_000_000 if number == 1 else 200_000_000)
        return msg
    bag = rewrite(tmp_path / 'swapped', swapped)
    assert_names(refused(bag=bag), bag, 'stamp')


def test_nan_in_the_site_file(refused, edited):
    def spoil(data):
        data['lines']['edge_right']['left_image'][3][1] = math.nan
    site = edited('site.yaml', spoil)
    assert_names(refused(site=site), site, 'edge_right', 'left_image', 'nan')


@pytest.mark.parametrize('name', ['site.yaml', 'init.yaml'])
def test_unknown_key(refused, edited, name):
    path = edited(name, lambda data: data.update(colour='blue'))
    line = refused(**{name.removesuffix('.yaml'): path})
    assert_names(line, path, 'colour')


@pytest.mark.parametrize('name', ['site.yaml', 'init.yaml'])
def test_file_that_is_not_yaml(refused, tmp_path, name):
    path = tmp_path / name
    path.write_text('lines: [1, {')
    assert_names(refused(**{name.removesuffix('.yaml'): path}), path)


@pytest.mark.parametrize('name', ['site.yaml', 'init.yaml'])
def test_missing_file(refused, tmp_path, name):
    path = tmp_path / 'nowhere' / name
    assert_names(refused(**{name.removesuffix('.yaml'): path}), path)


def test_lane_with_an_unknown_line(refused, edited):
    site = edited('site.yaml', lambda data: data['lanes'][0].update(left='kerb'))
    assert_names(refused(site=site), site, 'kerb')


@pytest.mark.parametrize('side', ['left_image', 'right_image'])
@pytest.mark.parametrize('shift', [[-400.0, 0.0], [610.0, 0.0], [0.0, -320.0], [0.0, 460.0]],
                         ids=['left', 'right', 'above', 'below'])
def test_quad_outside_the_image(refused, edited, side, shift):
    def move(data):
        quad = data['vehicles'][0][side]
        data['vehicles'][0][side] = [[u + shift[0], v + shift[1]] for u, v in quad]
    init = edited('init.yaml', move)
    assert_names(refused(init=init), init, side, '1024x768')


def test_annotation_in_a_missing_pair(refused, edited):
    init = edited('init.yaml', lambda data: data['vehicles'][0].update(frame=99))
    assert_names(refused(init=init), init, 'vehicles[0].frame', '99', '4')


@pytest.mark.parametrize(('option', 'value'), [
    ('--tracker', 'kalmann'), ('--seed', '-1'), ('--seed', 'x'), ('--particles', '0'),
    ('--particles', 'many'), ('--tolerance-ms', 'nan'), ('--tolerance-ms', '-1'),
    ('--colour', 'blue'),
])
def test_options(refused, option, value):
    assert_names(refused(option, value), option)


def test_unknown_parameter(refused, tmp_path):
    path = tmp_path / 'config.yaml'
    path.write_text(yaml.safe_dump({'partikles': 200}))
    assert_names(refused('--config', str(path)), path, 'partikles')


def test_out_is_a_file(capsys, sample, short_bag, tmp_path):
    out = tmp_path / 'taken'
    out.write_text('mine')
    assert main(['replay', str(short_bag), '--site', str(sample / 'site.yaml'),
                 '--init', str(sample / 'init.yaml'), '--out', str(out)]) == 2
    assert str(out) in capsys.readouterr().err
    assert out.read_text() == 'mine'


def test_as_a_process(sample, tmp_path):
    """The whole command once, as a process: exit status and standard error."""
    done = subprocess.run(
        [sys.executable, '-m', 'stereo_speed', 'replay', str(tmp_path / 'none.mcap'),
         '--site', str(sample / 'site.yaml'), '--init', str(sample / 'init.yaml'),
         '--out', str(tmp_path / 'out')],
        cwd=ROOT, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL)
    assert done.returncode == 2
    assert re.fullmatch(r'error: .*none\.mcap.*\n', done.stderr)
