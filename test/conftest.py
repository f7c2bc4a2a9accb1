# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Shared fixtures: a pass on a bend, clicked roads, small bags, a private ROS graph."""
from __future__ import annotations

from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
import fcntl
import gc
import os
from pathlib import Path
import tempfile
import time
from typing import Any, Callable, Optional

from stereo_speed.core.threads import one_blas_thread

one_blas_thread()  # as every command does, before numpy is loaded: other threads, other rounding

import cv2  # noqa: E402, I100
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from stereo_speed.geometry.camera import Camera  # noqa: E402
from stereo_speed.geometry.rig import StereoRig  # noqa: E402
from stereo_speed.io.bags import StereoBag  # noqa: E402
from stereo_speed.lab.sim.config import circle_config  # noqa: E402
from stereo_speed.lab.sim.sequence import simulate  # noqa: E402
from stereo_speed.pipeline.assembly import MeasuringSite  # noqa: E402
from stereo_speed.pipeline.config import PipelineConfig  # noqa: E402
from stereo_speed.pipeline.run import run  # noqa: E402
from stereo_speed.site.file import load_site  # noqa: E402
from stereo_speed.site.init_file import load_init  # noqa: E402
import yaml  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]


SEVERAL_PROCESSES = '/test/integration/', '/test/studio/'
COMMANDS = '/test/cli/', '/test/lab/cli/', '/test/batch/'


def pytest_collection_modifyitems(items):
    """
    Start with the files that take long, and rerun failed tests of several processes.

    A file is run by one worker, so a long one at the end would leave the others idle.  A busy
    machine may delay processes for too long: a DDS message sent before its receiver is
    discovered is lost, and a browser times out.
    """
    times = Counter()
    for item in items:
        times[item.path] += usual_s(item)
        if 'private_graph' in item.fixturenames or is_in(item, SEVERAL_PROCESSES):
            item.add_marker(pytest.mark.flaky(reruns=2))
    items.sort(key=lambda item: -times[item.path])  # stable: a file's tests keep their order


def is_in(item, rooms):
    """Return whether a test is in one of some rooms."""
    return any(room in item.path.as_posix() for room in rooms)


def usual_s(item):
    """Return roughly how long a test takes, s."""
    if is_in(item, SEVERAL_PROCESSES[:1]):
        return 8.0
    if item.get_closest_marker('slow'):
        return 4.0 if is_in(item, COMMANDS) else 2.0
    return 0.05


@pytest.fixture(scope='session')
def circle():
    """36 mph on a circle of 41 m radius."""
    return simulate(circle_config('36 mph', 41.0), np.random.default_rng(2))


@pytest.fixture(scope='session')
def private_graph():
    """Use a ROS domain that no other tests on this machine use; node processes inherit it."""
    for n in range(80):
        domain = 20 + (os.getpid() + n) % 80
        name = f'stereo_speed_domain_{os.getuid()}_{domain}'
        with ExitStack() as tried:
            try:
                lock = tried.enter_context((Path(tempfile.gettempdir()) / name).open('w'))
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:  # other tests use that domain
                continue
            held = tried.pop_all()
            break
    else:
        pytest.fail('no domain is free')
    os.environ['ROS_DOMAIN_ID'] = str(domain)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(ROOT / 'config' / 'fastdds.xml')
    with held:
        yield


@pytest.fixture()
def stand_in(private_graph):
    """Return a node whose ``wait(condition, seconds)`` spins it until the condition holds."""
    import rclpy
    # Nodes that ended with an error may survive as frozen garbage, and their services, which no
    # executor spins, would be found in place of the test's.
    gc.unfreeze()
    gc.collect()
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    context = Context()
    rclpy.init(context=context, args=[])
    node = rclpy.create_node('stand_in', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def wait(condition, seconds):
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
        assert condition(), 'the awaited event has not come'
    node.wait = wait
    yield node
    executor.shutdown(timeout_sec=1.0)
    node.destroy_node()
    rclpy.shutdown(context=context)


OFFSETS_M = {'edge_right': -1.75, 'line_0': 1.75, 'edge_left': 5.25}


@dataclass(frozen=True)
class Scene:
    """A rig, picks by line, and the true lane: points, arc lengths and tangents."""

    rig: StereoRig
    lines: dict
    lane_m: np.ndarray
    s_m: np.ndarray
    tangent: np.ndarray


def make_rig(distorted=False):
    """Make a rig; the distorted one has converging cameras."""
    k = np.array([[1500.0, 0.0, 511.5], [0.0, 1500.0, 383.5], [0.0, 0.0, 1.0]])
    d = (-0.21, 0.12, 1e-3, -7e-4) if distorted else ()
    cameras = [Camera(name=n, width_px=1024, height_px=768, K=k, D=d, model='plumb_bob')
               for n in ('left', 'right')]
    r, t = ((0.004, -0.02, 0.003), (-0.5, 0.006, 0.01)) if distorted else ((0, 0, 0), (-0.5, 0, 0))
    return StereoRig(*cameras, cv2.Rodrigues(np.array(r, dtype=float))[0], np.array(t))


def build_scene(curvature=0.0, grade=0.0, seed=0, std_px=0.3, distorted=False, crest=0.0,
                twist=0.0, step_m=0.0):
    """
    Return a road of constant curvature (1/m), 120 m or 65 m long, seen from ahead.

    :param grade: in its middle.
    :param crest: by how much the grade falls, per metre.
    :param twist: by how much the crossfall grows from its middle to its end.
    :param step_m: offset of the middle line to the left from 0.5 to 0.7 of the road.
    """
    rng, rig = np.random.default_rng(seed), make_rig(distorted)
    s = np.linspace(0, 120 if curvature < 0.02 else 65, 2401)
    psi = curvature * s
    tangent = np.stack([np.cos(psi), np.sin(psi), grade - crest * (s - s[-1] / 2)], -1)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    way = np.cumsum((tangent[1:] + tangent[:-1]) / 2 * np.diff(s)[:, None], axis=0)
    points = np.concatenate([np.zeros((1, 3)), way])
    left = np.stack([-np.sin(psi), np.cos(psi), twist * (2 * s / s[-1] - 1)], -1)
    eye = points[-1] + 14 * tangent[-1] - 8 * left[-1] + [0, 0, 6.0]
    z = 0.45 * points[1200] + 0.55 * points[-1] - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z])
    off = {'line_0': step_m * ((s > 0.5 * s[-1]) & (s < 0.7 * s[-1]))}
    lines = {name: _picked(rig, (points + (o + off.get(name, 0 * s))[:, None] * left - eye)
                           @ axes.T, rng, std_px) for name, o in OFFSETS_M.items()}
    lane = (points - eye) @ axes.T
    seen = rig.left.project(lane)[1] & (lane[:, 2] < 80)
    return Scene(rig, lines, lane[seen], s[seen] - s[seen][0], (tangent @ axes.T)[seen])


def _picked(rig, points, rng, std_px):
    """Pick 14 points of a line in each view, evenly along the image curve, with scatter."""
    out = []
    for uv, valid in zip(rig.project(points)[:2], rig.project(points)[2:]):
        uv = uv[valid & (points[:, 2] < 90)]
        along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(uv, axis=0), axis=-1))])
        at = np.linspace(0, along[-1], 14)
        exact = np.stack([np.interp(at, along, uv[:, i]) for i in (0, 1)], -1)
        out.append(exact + rng.normal(0, std_px, exact.shape))
    return tuple(out)


@pytest.fixture(scope='session')
def make_scene():
    """Return a maker of scenes: (curvature, grade, seed, std_px, distorted) to Scene."""
    return build_scene


SAMPLE = ROOT / 'sample' / 'straight55'
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
    Return the function that rewrites the first pairs of the sample's bag.

    Its ``change(topic, number, msg)`` returns the message to write, or None to leave it out.
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
    """Return a bag with the first pairs of the sample."""
    return rewrite(tmp_path_factory.mktemp('short') / 'bag')


@pytest.fixture
def edited(tmp_path) -> Callable[[str, Callable[[dict], None]], Path]:
    """Return a function that edits a copy of one of the sample's YAML files."""
    def edit(name: str, change: Callable[[dict], None]) -> Path:
        data = yaml.safe_load((SAMPLE / name).read_text())
        change(data)
        path = tmp_path / name
        path.write_text(yaml.safe_dump(data))
        return path
    return edit


VEHICLE_HEIGHT_M = 1.45
QUAD_HEIGHT_M = 0.3  # of the lower edge of the annotated front above the road


@pytest.fixture(scope='session')
def sample_boxes(sample):
    """Boxes (left, top, width, height) around the vehicle of the sample, by stamp."""
    with StereoBag(sample / 'bag') as bag:
        place = MeasuringSite.of(load_site(sample / 'site.yaml'), bag.rig)
        annotated = place.pipeline(PipelineConfig(), load_init(sample / 'init.yaml'))
        updates = run(annotated, bag.pairs()).updates
        px_per_m = {u.stamp_ns: bag.rig.left.K[0, 0] / u.position_m[2] for u in updates}
    out = {}
    for update in updates[:1] + updates[2:]:
        left, right = update.quad_left_px[:, 0].min(), update.quad_left_px[:, 0].max()
        bottom = update.quad_left_px[:, 1].max()
        scale = px_per_m[update.stamp_ns]
        out[update.stamp_ns] = (left - 1, bottom + (QUAD_HEIGHT_M - VEHICLE_HEIGHT_M) * scale,
                                right - left + 2, VEHICLE_HEIGHT_M * scale)
    return out
