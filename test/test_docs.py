# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The documentation refers to existing things, and its examples run."""
from __future__ import annotations

import argparse
from dataclasses import replace
from functools import cache, partial
import importlib.util
from pathlib import Path
import re
import runpy
import sys
from typing import Any

import numpy as np
import pytest
from stereo_speed.cli.main import build_parser, COMMANDS
from stereo_speed.core.passes import PassResult, Reason, Verdict
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.core.units import MPH_MPS
from stereo_speed.geometry import distortion
from stereo_speed.io import results
from stereo_speed.io.bags import StereoBag
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.pipeline.pipeline import SpeedPipeline
from stereo_speed.pipeline.registry import DETECTORS, TRACKERS
from stereo_speed.pipeline.run import run
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'stereo_speed'
PAGES = [*sorted(ROOT.glob('*.md')), *sorted((ROOT / 'docs').glob('*.md'))]
FENCE = re.compile(r'^ *```([^\n]*)\n(.*?)^ *```', re.MULTILINE | re.DOTALL)
IDENTIFIER = re.compile(r'[a-z]{2,}(_[a-z0-9]+)+|([A-Z][a-z]+){2,}|[A-Z]+(_[A-Z]+)+')
MADE = ('out', 'build')  # folders that commands make
FOREIGN = {'message_filters', 'cv_bridge', 'camera_calibration', 'robot_localization',
           'image_view', 'image_saver', 'diagnostic_updater', 'diagnostic_aggregator',
           'vision_msgs', 'respawn_max_retries',
           'u_matching', 'u_path', 'u_stamps', 'u_calibration',
           'site_left', 'site_right'}  # names of other packages, of formulas and of pictures
TRUE_MPH = 55.0  # of the sample

each_page = pytest.mark.parametrize('page', PAGES, ids=lambda p: str(p.relative_to(ROOT)))


def blocks(page: Path, info: str) -> str:
    """Return the code blocks of a page that have an info string, in order."""
    return '\n\n'.join(body for found, body in FENCE.findall(page.read_text()) if found == info)


def prose(page: Path) -> str:
    """Return a page without its code blocks."""
    return FENCE.sub('', page.read_text())


def spans(page: Path) -> set[str]:
    """Return the texts between backquotes in the prose of a page."""
    return {' '.join(span.split()) for span in re.findall(r'(?<!`)`([^`]+)`(?!`)', prose(page))}


def anchor(heading: str) -> str:
    """Return the anchor that GitHub gives a heading."""
    return re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-')


@cache
def words_of_the_code() -> set[str]:
    """Return all words in code, configuration and the examples for contributors."""
    folders = ('stereo_speed', 'test', 'config', 'launch', 'tools', 'sample')
    files = [f for folder in folders for f in (ROOT / folder).rglob('*')
             if f.suffix in ('.py', '.yaml', '.xml') and f.name != 'test_docs.py']
    stems = [f.stem for f in files]
    text = ' '.join(f.read_text() for f in [*files, *(ROOT / name for name in (
        'setup.py', 'package.xml', 'Makefile'))])
    examples = FENCE.findall((ROOT / 'CONTRIBUTING.md').read_text())
    return set(re.findall(r'\w+', ' '.join([text, *stems, *(body for _, body in examples)])))


# -- names exist ------------------------------------------------------------------------------


@each_page
def test_links_have_targets(page):
    for target in re.findall(r'\]\(([^)\s]+)\)', prose(page)):
        if target.startswith(('http:', 'https:')):
            continue
        name, _, part = target.partition('#')
        path = (page.parent / name).resolve() if name else page
        assert path.exists(), target
        if part:
            headings = re.findall(r'^#+ (.*)$', prose(path), re.MULTILINE)
            assert part in {anchor(h) for h in headings}, target


@each_page
def test_paths_exist(page):
    """A path counts from the root or from the package; a bare file name may be anywhere."""
    folders = ('stereo_speed', 'test', 'docs', 'config', 'tools')
    files = {str(f.relative_to(ROOT)) for folder in folders
             for f in (ROOT / folder).rglob('*')} | {f.name for f in ROOT.iterdir()}
    for span in spans(page):
        if re.fullmatch(r'[\w./-]+\.(py|md|rst|xml|cfg|lock|params\.yaml)', span):
            assert any(f'/{file}'.endswith(f'/{span}') for file in files), span
        elif re.fullmatch(r'(\w+/)+', span) and span.split('/')[0] not in MADE:
            assert (ROOT / span).is_dir() or (PACKAGE / span).is_dir(), span


@each_page
def test_make_targets_exist(page):
    targets = set(re.findall(r'^([\w-]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE))
    named = re.findall(r'(?:^|`)make ([a-z-]+)', page.read_text(), re.MULTILINE)
    assert set(named) <= targets


def test_every_make_target_is_explained():
    declared = re.search(r'^\.PHONY: (.*)$', (ROOT / 'Makefile').read_text(), re.MULTILINE)
    assert {f'make {t}' for t in declared[1].split()} <= spans(ROOT / 'CONTRIBUTING.md')


def options_of(command: str) -> set[str]:
    """Return the options of a command and of its actions."""
    found: set[str] = set()

    def walk(parser: argparse.ArgumentParser) -> None:
        for action in parser._actions:
            found.update(action.option_strings)
            if isinstance(action, argparse._SubParsersAction):
                for inner in action.choices.values():
                    walk(inner)
    top = build_parser(command)._subparsers._group_actions[0]
    walk(top.choices[command])
    return found


def test_commands_and_options_exist():
    options = {command: options_of(command) for command in COMMANDS}
    everywhere = set().union(*options.values()) | {'--ros-args'}
    commands = '|'.join(sorted(COMMANDS, key=len, reverse=True))
    for page in PAGES:
        text = page.read_text().replace('\\\n', ' ')
        lines = [line for _, body in FENCE.findall(text) for line in body.splitlines()]
        for line in [*lines, *spans(page)]:
            called = re.search(r'-m stereo_speed ([\w-]+)', line)
            if called:
                assert called[1] in COMMANDS, (page.name, line)
            called = called or re.match(rf'({commands})(?= |$)', line)
            known = options[called[1]] if called else everywhere
            if called or line.startswith('--'):
                used = set(re.findall(r'(?<=[ `])--[a-z][\w-]*', ' ' + line.partition(' #')[0]))
                assert used <= known, (page.name, line)


@each_page
def test_names_of_code_exist(page):
    """Identifiers of two words or more occur in the code or in the examples."""
    known = words_of_the_code() | FOREIGN
    for span in spans(page):
        for name in re.findall(r'(?<![\w./-])[A-Za-z_][\w.]*\w(?![\w/-])', span):
            for part in re.sub(r'\.(png|py)$', '', name).split('.'):
                assert part in known or not IDENTIFIER.fullmatch(part), f'{part} in {span}'


def test_all_pages_are_in_the_index():
    index = (ROOT / 'docs' / 'README.md').read_text()
    for page in PAGES:
        if page.name != 'README.md':
            assert f'{page.name})' in index
    for page in ('docs/README.md', 'CONTRIBUTING.md'):
        assert f'({page})' in (ROOT / 'README.md').read_text()


def test_every_reason_is_explained():
    rows = re.findall(r'^\| `(\w+)` \|', (ROOT / 'docs' / 'method.md').read_text(), re.MULTILINE)
    assert set(rows) == {reason.value for reason in Reason}


# -- the rooms --------------------------------------------------------------------------------


def test_table_of_rooms_equals_that_of_the_layer_test():
    layers = runpy.run_path(str(ROOT / 'test' / 'test_layers.py'))
    text = (ROOT / 'docs' / 'architecture.md').read_text()
    rows = re.findall(r'^\| (\d+) \| `([\w.]+)` \| [^|]+ \|([^|]*)\|$', text, re.MULTILINE)
    assert [(int(rank), room) for rank, room, _ in rows] == [
        (rank, room) for rank, rooms in enumerate(layers['LAYERS']) for room in rooms]
    messages = layers['ROS_MESSAGES']
    for _, room, libraries in rows:
        reserved = {name for name, rooms in layers['ROOMS_OF'].items() if room in rooms}
        named = set(re.findall(r'`(\w+)`', libraries)) | (
            set(messages) if 'messages' in libraries else set())
        assert named == reserved, room


# -- the examples run -------------------------------------------------------------------------


@pytest.fixture(scope='module')
def sample():
    """Return the sample's site as clicked, and its pairs."""
    folder = ROOT / 'sample' / 'straight55'
    with StereoBag(folder / 'bag') as bag:
        return MeasuringSite.of(load_site(folder / 'site.yaml'), bag.rig), list(bag.pairs())


@pytest.fixture(scope='module')
def example(tmp_path_factory):
    """Install the package of CONTRIBUTING beside the others, as pip would."""
    folder = tmp_path_factory.mktemp('site-packages')
    page = ROOT / 'CONTRIBUTING.md'
    (folder / 'example_speed.py').write_text(blocks(page, 'python example_speed.py'))
    taken: dict[str, dict[str, list[str]]] = {}
    setup = blocks(page, 'python setup.py').replace(
        'from setuptools import setup', 'setup = taken.update')
    exec(compile(setup, 'setup.py', 'exec'), {'taken': taken})
    info = folder / 'example_speed-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: example_speed\nVersion: 1.0\n')
    (info / 'entry_points.txt').write_text(''.join(
        f'[{group}]\n' + '\n'.join(points) + '\n'
        for group, points in taken['entry_points'].items()))
    sys.path.insert(0, str(folder))
    importlib.invalidate_caches()
    yield
    sys.path.remove(str(folder))


@pytest.mark.slow
def test_python_example_of_the_readme(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    code = blocks(ROOT / 'README.md', 'python')
    assert len(code.strip().splitlines()) <= 15
    exec(compile(code, 'README.md', 'exec'), {})
    lane, mph, std = re.fullmatch(r'(\w+): ([\d.]+) ± ([\d.]+) mph\n', capsys.readouterr().out
                                  ).groups()
    assert lane == 'lane_0'
    assert abs(float(mph) - TRUE_MPH) < 4 * float(std)
    said = re.search(r'prints `lane_0: ([\d.]+) ± ([\d.]+) mph`',
                     (ROOT / 'README.md').read_text())
    assert (float(said[1]), float(said[2])) == pytest.approx((float(mph), float(std)), abs=0.02)


@pytest.mark.parametrize('detected', [False, True], ids=['annotated', 'detected'])
def test_examples_of_a_tracker_and_a_detector(example, sample, detected):
    site, pairs = sample
    trackers, detectors = replace(TRACKERS), replace(DETECTORS)  # that search for packages again
    start = partial(trackers.load('sliding').start,
                    settings=trackers.settings('sliding', {}, 'example'))
    detector = detectors.load('gate')(site.rig, site.lanes,
                                      detectors.settings('gate', {}, 'example'))
    annotations = load_init(ROOT / 'sample' / 'straight55' / 'init.yaml')
    pipeline = SpeedPipeline(site.rig, site.lanes, TrackerConfig(), start,
                             annotations=() if detected else annotations,
                             detector=detector if detected else None)
    one, = run(pipeline, pairs).passes
    assert one.verdict is Verdict.MEASURED
    assert one.pairs == len(pairs) - detected  # the detector compares with an earlier pair
    assert abs(one.speed_mps - TRUE_MPH * MPH_MPS) < 4 * one.speed_std_mps
    if not detected:
        said = re.search(r'it reads ([\d.]+) ± ([\d.]+) mph', prose(ROOT / 'CONTRIBUTING.md'))
        assert (float(said[1]), float(said[2])) == pytest.approx(
            (one.speed_mps / MPH_MPS, one.speed_std_mps / MPH_MPS), abs=0.02)


def test_example_of_a_camera_model():
    scope = dict(vars(distortion))
    exec(compile(blocks(ROOT / 'CONTRIBUTING.md', 'python stereo_speed/geometry/distortion.py'),
                 'CONTRIBUTING.md', 'exec'), scope)
    lens = scope['FieldOfView'](np.array([0.9]))
    xy = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 2))
    np.testing.assert_allclose(lens.undistort(lens.distort(xy)), xy, atol=1e-8)
    # By hand: a ray at tan(0.45) to the axis is distorted to atan(2 tan(0.45)^2) / 0.9.
    r = np.tan(0.45)
    np.testing.assert_allclose(lens.distort(np.array([[0.0, r]])),
                               [[0.0, np.arctan(2 * r * r) / 0.9]])
    np.testing.assert_array_equal(scope['FieldOfView'](np.array([0.0])).distort(xy), xy)


def test_example_of_an_output_format():
    scope = dict(vars(results))
    exec(compile(blocks(ROOT / 'CONTRIBUTING.md', 'python stereo_speed/io/results.py'),
                 'CONTRIBUTING.md', 'exec'), scope)
    passes = [PassResult(track=k, lane='near', first_ns=1, last_ns=9, pairs=5, speed_mps=24.5,
                         speed_std_mps=0.1, verdict=Verdict.MEASURED, reason='',
                         smoothed={1: 24.5}, smoothed_std={1: 0.1}) for k in (1, 0)]
    first, second = scope['passes_jsonl'](passes).splitlines()
    assert '"track": 0' in first and '"track": 1' in second
    assert '"verdict": "measured"' in first and '"speed_mps": 24.5' in first


def test_example_of_boxes():
    pytest.importorskip('rclpy')
    from std_msgs.msg import Header
    from stereo_speed.nodes.boxes import boxes_from_message
    scope: dict[str, Any] = {}
    exec(compile(blocks(ROOT / 'CONTRIBUTING.md', 'python boxes_of_a_network.py'),
                 'CONTRIBUTING.md', 'exec'), scope)
    message = scope['as_message'](Header(frame_id='left'), [(10.0, 20.0, 30.0, 40.0, 0.5)])
    assert message.header.frame_id == 'left'
    box, = boxes_from_message(message)
    assert (box.left_px, box.top_px, box.width_px, box.height_px, box.score) == (
        10.0, 20.0, 30.0, 40.0, 0.5)


def test_example_of_a_node(tmp_path, private_graph):
    rclpy = pytest.importorskip('rclpy')
    from geometry_msgs.msg import TwistWithCovarianceStamped
    path = tmp_path / 'limit_node.py'
    path.write_text(blocks(ROOT / 'CONTRIBUTING.md', 'python stereo_speed/nodes/limit_node.py'))
    spec = importlib.util.spec_from_file_location('stereo_speed.nodes.limit_node', path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    rclpy.init(args=['--ros-args', '-p', 'limit_mps:=20.0'])
    try:
        node = module.LimitNode()
        passed = []
        node.publisher.publish = passed.append
        for speed_mps, variance in ((19.0, 0.01), (20.5, 0.25), (21.5, 0.25)):
            msg = TwistWithCovarianceStamped()
            msg.twist.twist.linear.x, msg.twist.covariance[0] = speed_mps, variance
            node.on_reading(msg)
        assert [msg.twist.twist.linear.x for msg in passed] == [21.5]
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


def test_examples_keep_the_line_length():
    for page in PAGES:
        for info, body in FENCE.findall(page.read_text()):
            if info.startswith('python'):
                assert max(map(len, body.splitlines())) <= 99, body
