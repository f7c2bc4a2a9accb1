# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
``demo``: measure the sample live and offline, and compare the results.

First the site is refined with the sample's own images.  Then the live nodes detect and measure
the vehicle automatically: they run as separate processes over DDS, in their own domain and on
this machine only; the sample bag is played in real time; a listener reads ``/vehicle_speed`` as
any other user's node would.
"""
from __future__ import annotations

import argparse
from contextlib import AbstractContextManager, ExitStack
import fcntl
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from typing import Mapping, Optional, Sequence, TextIO

import cv2
import numpy as np
from numpy.typing import NDArray

from .demo_evidence import demo_key, records, show
from .replay import measure, print_table
from .site import refined_from_bag, write_pictures, write_site
from ..core.errors import StereoSpeedError
from ..core.records import TrackState
from ..core.sampling import evenly
from ..core.units import MPH_MPS
from ..io.bags import StereoBag
from ..io.truth import read_truth, VehicleTruth
from ..io.video_writer import VideoWriter
from ..pipeline.assembly import MeasuringSite
from ..pipeline.config import PipelineConfig
from ..pipeline.run import Run
from ..report.overlay import strip
from ..report.plots import write_plots
from ..road.lanes import LanePath
from ..site.file import load_site
from ..site.refine.report import report, summary_lines

# The checkout; or, of an installed package, the folder that setup.py's data_files go to.
_SOURCES = Path(__file__).resolve().parents[2]
_ROOT = _SOURCES if (_SOURCES / 'sample').is_dir() else (
    _SOURCES.parents[2] / 'share' / 'stereo_speed')
_START_S, _DELIVERY_S, _STOP_S = 60.0, 30.0, 5.0  # longest waits
_SETTLE_S = 0.5  # after the listener has discovered a topic, for the other nodes to do so too
# A short bag played once cannot afford lost images, which nodes tolerate from a camera.
RELIABLE_IMAGES, RELIABLE_INFOS = (
    [f'qos_overrides./{side}/{topic}.subscription.reliability:=reliable'
     for side in ('left', 'right')] for topic in ('image_raw', 'camera_info'))

# On a busy machine, too, no pair is skipped or hurried, so that live and offline agree.
EVERY_PAIR = 'most_wait_s:=60', 'hurry:=false'
# The whole chain must be connected before the first image.
WHOLE_CHAIN = 'wait_for_topics:=stereo/image_pair tracks'

_FIRST_DOMAIN, _DOMAINS = 20, 80  # ROS domains that private graphs use
_domain_locks: list[TextIO] = []  # locked files, which are released when this process ends

Reading = tuple[int, str, float, float]  # stamp ns, vehicle, speed and 1-sigma m/s


class DemoError(StereoSpeedError):
    """The demo did not produce the expected result."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``demo``."""
    parser.add_argument('--sample', type=Path, default=_ROOT / 'sample' / 'straight55',
                        help='folder with bag/, site.yaml, init.yaml and truth.csv')
    parser.add_argument('--out', type=Path, default=Path('out'), help='folder to write')
    parser.add_argument('--rate', type=float, default=1.0,
                        help='speed of the replay; 2 is twice as fast as recorded')


def run(args: argparse.Namespace) -> int:
    """Refine the site, measure offline and live, and compare with the truth and each other."""
    sample: Path = args.sample
    args.out.mkdir(parents=True, exist_ok=True)
    truth = read_truth(sample / 'truth.csv')[0]
    site = _refined_site(sample, args.out)
    offline, lanes = _offline(sample, site)
    expected = {u.stamp_ns: u.speed_mps for u in offline.updates
                if u.state is TrackState.CONFIRMED}
    key, evidence = demo_key(args.out), args.out / 'evidence'
    older = records(evidence)
    readings, frames = live(sample, site, len(expected), args.rate, truth,
                            evidence=(evidence, key))
    write_plots(args.out, offline.updates, offline.passes, lanes, truth={'truth': list(zip(
        truth.stamps_ns.tolist(), truth.speed_mps.tolist()))})
    write_frames(args.out, frames)
    print('\nthe whole pass, offline:')
    print_table(offline.passes)
    missing = sorted(set(expected) - {r[0] for r in readings})
    if missing:
        raise DemoError(f'demo: /vehicle_speed: found {len(readings)} readings, wanted '
                        f'{len(expected)}; first missing stamp: {missing[0]} ns')
    apart = max(abs(speed - expected[ns]) for ns, _, speed, _ in readings)
    print(f'live and offline readings differ by at most {apart / MPH_MPS:.6f} mph')
    print(f'frames and plots are in {args.out}/')
    violation = sorted(records(evidence) - older)
    if not violation:
        raise DemoError(f'demo: {evidence}: found no new record, wanted one for the violation')
    print('\n' + '\n'.join(show(args.out, violation[-1], key)))
    return 0


def _refined_site(sample: Path, out: Path) -> Path:
    """Refine the clicked site with the images, and return the path of the refined site file."""
    refined = refined_from_bag(load_site(sample / 'site.yaml'), sample / 'bag')
    print('the site, refined by the images of the bag:')
    for line in summary_lines(refined, report(refined)):
        print(line)
    write_site(out / 'site.yaml', refined.site)
    write_pictures(out, 'site', refined)
    return out / 'site.yaml'


def _offline(sample: Path, site: Path) -> tuple[Run, Mapping[str, LanePath]]:
    """Run the same bag through the pipeline in this process."""
    with StereoBag(sample / 'bag') as bag:
        place = MeasuringSite.of(load_site(site), bag.rig)
        pipeline = place.pipeline(PipelineConfig(), None)
        return measure(bag, pipeline, keep_frames=False)[0], place.lanes


def live(sample: Path, site: Path, wanted: int, rate: float, truth: VehicleTruth, *,
         parameters: Sequence[str] = (), evidence: Optional[tuple[Path, Path]] = None
         ) -> tuple[list[Reading], dict[int, NDArray[np.uint8]]]:
    """
    Play the sample through the nodes.

    :param site: site file.
    :param parameters: further parameters of the tracker node, ``name:=value``.
    :param wanted: number of readings to wait for.
    :param rate: pace of the replay.
    :param truth: true speeds, printed beside the readings.
    :param evidence: folder for records of violations, and the key that signs them.
    :return: the readings, and the overlay frames by stamp.
    """
    private_graph()
    from ..nodes.demo_listener import Listener
    readings: list[Reading] = []
    frames: dict[int, NDArray[np.uint8]] = {}

    def on_reading(ns: int, vehicle: str, speed: float, std: float) -> None:
        readings.append((ns, vehicle, speed, std))
        print(reading_line((ns, vehicle, speed, std), truth), flush=True)

    with ExitStack() as stack:
        nodes = [stack.enter_context(Process(*command)) for command in (
            ('stereo_sync_node', *RELIABLE_IMAGES, *RELIABLE_INFOS),
            ('tracker_node', f'site:={site}', *EVERY_PAIR, *RELIABLE_INFOS, *parameters),
            ('speed_node',))]
        older = set() if evidence is None else records(evidence[0])
        more = ''
        if evidence is not None:
            more = ' pass_traces'
            nodes.append(stack.enter_context(Process(
                'evidence_node', *RELIABLE_IMAGES, f'out:={evidence[0]}',
                f'key:={evidence[1]}')))
        listener = Listener(on_reading, frames.__setitem__)
        stack.callback(listener.close)
        if not listener.spin(_START_S, lambda: _check(nodes) and not listener.missing_wires()):
            raise DemoError(
                f'demo: graph: found no connection on {", ".join(listener.missing_wires())} after '
                f'{_START_S:.0f} s, wanted all nodes connected')
        listener.spin(_SETTLE_S, lambda: False)
        print('\nnodes connected; readings on /vehicle_speed:')
        replay = stack.enter_context(Process('replay_node', f'bag:={sample / "bag"}',
                                             f'rate:={rate}', WHOLE_CHAIN + more))
        # The replay waits for its subscribers, plays for the bag's length, and ends.
        span_s = int(np.ptp(truth.stamps_ns)) * 1e-9 / rate
        listener.spin(_START_S + span_s, lambda: _check(nodes) and replay.ended())
        listener.spin(_DELIVERY_S, lambda: _check(nodes) and len(readings) >= wanted)
        if evidence is not None:
            listener.spin(_DELIVERY_S, lambda: _check(nodes) and records(evidence[0]) != older)
        listener.spin(_SETTLE_S, lambda: False)
    return readings, frames


def reading_line(reading: Reading, truth: VehicleTruth) -> str:
    """Return a line that shows a reading, with its error where the truth is known."""
    ns, vehicle, speed, std = reading
    true = float(truth.speed_at([ns])[0])
    error = '' if np.isnan(true) else (f'   truth {true / MPH_MPS:6.2f}   '
                                       f'error {(speed - true) / MPH_MPS:+.2f}')
    return (f'{(ns - int(truth.stamps_ns[0])) * 1e-9:5.1f} s  {vehicle}  {speed / MPH_MPS:6.2f} ± '
            f'{std / MPH_MPS:.2f} mph{error}')


def _check(nodes: Sequence[Process]) -> bool:
    """Return True while all nodes run; raise when one has ended by itself."""
    for node in nodes:
        if node.ended():
            raise DemoError(f'demo: {node.name}: found it ended with status '
                            f'{node.process.returncode}, wanted it running')
    return True


def private_graph() -> None:
    """Isolate the demo's ROS graph: its own domain, this machine only, large messages."""
    if 'ROS_DOMAIN_ID' not in os.environ:
        os.environ['ROS_DOMAIN_ID'] = str(_free_domain())
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    profile = _ROOT / 'config' / 'fastdds.xml'
    if profile.exists():
        os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(profile))


def _free_domain() -> int:
    """
    Return the number of a domain that no other private graph of this user has on this machine.

    The domain is reserved until this process ends.

    :raises DemoError: no domain is free.
    """
    for n in range(_DOMAINS):
        domain = _FIRST_DOMAIN + (os.getpid() + n) % _DOMAINS
        name = f'stereo_speed_domain_{os.getuid()}_{domain}'
        lock = (Path(tempfile.gettempdir()) / name).open('w')
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # another graph has this domain
            lock.close()
            continue
        _domain_locks.append(lock)
        return domain
    raise DemoError('demo: ROS_DOMAIN_ID: found all domains taken, wanted a free one')


class Process(AbstractContextManager['Process']):
    """
    A node in its own process; a context manager that ends the process on exit.

    :param name: module of the node.
    :param parameters: its ROS parameters, ``name:=value``.
    :param namespace: namespace that the node runs in.
    """

    def __init__(self, name: str, *parameters: str, namespace: str = '/') -> None:
        self.name = name
        command = [sys.executable, '-m', f'stereo_speed.nodes.{name}']
        command += ['--ros-args', '-r', f'__ns:={namespace}']
        command += [word for p in parameters for word in ('-p', p)]
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL)

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        try:
            self.process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(_STOP_S)

    def ended(self) -> bool:
        """Return whether the process has ended."""
        return self.process.poll() is not None


def write_frames(out: Path, frames: dict[int, NDArray[np.uint8]]) -> None:
    """Write a contact sheet of annotated frames, and a video of all of them."""
    images = [frames[ns] for ns in sorted(frames)]
    if not images:
        raise DemoError('demo: overlay/image_raw: found no frames, wanted one a pair')
    cv2.imwrite(str(out / 'demo_strip.png'), strip(evenly(images, 9)))
    video = VideoWriter(out / 'demo.avi', images[0].shape, rate_hz=5.0)
    try:
        for image in images:
            video.write(image)
        video.keep()
    finally:
        video.close()
