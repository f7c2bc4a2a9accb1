# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Damaged input for all readers of files, one case after the other.

Whatever a file contains, its reader must either accept it or refuse it by one of this package's
errors, which is one line (``fuzz_judge``); and no vehicle may be measured wrongly from a recording
with damaged images. Case k of a seed is always the same.
"""
from __future__ import annotations

import csv
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
import tempfile
import time
from typing import Any, Callable, Mapping, Sequence

import cv2
import numpy as np
import yaml

from .fuzz_evidence import evidence_case
from .fuzz_judge import judge, Outcome
from .fuzz_messages import bomb_case, image_case, info_case
from ..evaluation.tables import Table
from ..sim.damage import damage_bytes, damage_mcap, damage_value
from ..sim.repeat import damaged_copy, repeat_bag
from ..sim.write import write_pairs
from ...cli.main import main
from ...core.config import load_config
from ...core.records import StereoPair
from ...core.units import MPH_MPS
from ...enforcement.config import EnforcementConfig, load_enforcement_config
from ...geometry.camera import Camera
from ...geometry.rig import StereoRig
from ...io.bags import StereoBag
from ...io.boxes import load_boxes
from ...io.scene_map import load_map, load_regions
from ...io.targets_file import load_targets
from ...io.truth import read_truth
from ...io.video import read_frames
from ...monocular.config import MonocularConfig
from ...pipeline.config import load_pipeline_config
from ...site.file import load_site
from ...site.init_file import load_init

SAMPLE = Path(__file__).resolve().parents[3] / 'sample' / 'straight55'
BATCH = 20  # cases of one job
_TRUE_MPS = 55 * MPH_MPS
_WRONG = 0.1  # a reading with a greater relative error is wrong

Rng = np.random.Generator
Case = Callable[[Rng, Path], Callable[[], object]]


def run_case(seed: int, number: int, folder: Path) -> Outcome:
    """
    Make a case, run it, and judge it.

    :param seed: seed of all cases.
    :param number: number of the case.
    :param folder: an empty folder, for its files.
    """
    rng = np.random.default_rng([seed, number])
    name = _ORDER[number % len(_ORDER)]
    call = SUBJECTS[name](rng, folder)
    return judge(name, call, folder)


def work(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """
    Run a batch of cases; runs in a worker process.

    :param parameters: seed, number of the first case, and number of cases.
    :return: counts of refused and accepted inputs by subject, and the faults.
    """
    counts: dict[str, list[int]] = {}
    faults: list[str] = []
    slowest = 0.0
    for number in range(parameters['first'], parameters['first'] + parameters['count']):
        with tempfile.TemporaryDirectory(prefix='fuzz-') as folder:
            start = time.process_time()
            outcome = run_case(parameters['seed'], number, Path(folder))
            slowest = max(slowest, time.process_time() - start)
        refused, taken = counts.setdefault(outcome.subject, [0, 0])
        counts[outcome.subject] = [refused + outcome.refused, taken + (not outcome.refused)]
        if outcome.fault:
            faults.append(f'case {number}, {outcome.subject}: {outcome.fault}')
    return {'counts': counts, 'faults': faults, 'slowest_s': slowest}


def fuzz_table(values: Sequence[Mapping[str, Any]]) -> Table:
    """Tabulate how many cases of each subject were refused and accepted."""
    counts = {name: [sum(v['counts'].get(name, [0, 0])[k] for v in values) for k in (0, 1)]
              for name in SUBJECTS}
    rows = [[name, sum(both), *both] for name, both in counts.items() if sum(both)]
    rows.append(['all', *(sum(row[k] for row in rows) for k in (1, 2, 3))])
    return Table(title='Damaged input',
                 columns=['input', 'cases', 'refused in one line', 'accepted'], rows=rows,
                 note='Longest case: '
                 f'{max((v["slowest_s"] for v in values), default=0.0):.1f} s of processor time.')


# -- subjects ---------------------------------------------------------------------------------


def _yaml_case(name: str, text: str, load: Callable[[Path], object]) -> Case:
    """Return cases of a YAML file with damaged values or bytes."""
    def case(rng: Rng, folder: Path) -> Callable[[], object]:
        path = folder / name
        if rng.random() < 0.7:
            tree = yaml.safe_load(text)
            for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
                tree = damage_value(rng, tree)
            path.write_text(yaml.safe_dump(tree, allow_unicode=bool(rng.random() < 0.5)))
        else:
            path.write_bytes(damage_bytes(rng, text.encode()))
        return lambda: load(path)
    return case


def _bytes_case(name: str, make: Callable[[], bytes], load: Callable[[Path], object]) -> Case:
    """Return cases of a file with damaged bytes."""
    def case(rng: Rng, folder: Path) -> Callable[[], object]:
        path = folder / name
        path.write_bytes(damage_bytes(rng, make()))
        return lambda: load(path)
    return case


def _bag_case(storage: str) -> Case:
    """Return cases of a tiny bag with a damaged file."""
    def case(rng: Rng, folder: Path) -> Callable[[], object]:
        path = folder / ('bag.bag' if storage == 'ros1' else 'bag')
        files = dict(_tiny_bag(storage))
        name = str(rng.choice(sorted(files)))
        if storage == 'mcap' and name.endswith('.mcap') and rng.random() < 0.8:
            files[name] = damage_mcap(rng, files[name])
        elif name.endswith('.yaml') and rng.random() < 0.7:
            tree = damage_value(rng, yaml.safe_load(files[name]))
            files[name] = yaml.safe_dump(tree).encode()
        else:
            files[name] = damage_bytes(rng, files[name])
        if storage != 'ros1':
            path.mkdir()
        for file, data in files.items():
            (path if storage == 'ros1' else path / file).write_bytes(data)

        def read() -> object:
            with StereoBag(path) as bag:
                for _ in bag.pairs():
                    pass
            return None
        return read
    return case


@lru_cache(maxsize=None)
def _tiny_bag(storage: str) -> tuple[tuple[str, bytes], ...]:
    """Return the files of a bag of three pairs of small images."""
    rng = np.random.default_rng(0)
    k = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
    left, right = (Camera(name=n, width_px=16, height_px=12, K=k, D=np.zeros(5),
                          model='plumb_bob') for n in ('left', 'right'))
    rig = StereoRig(left, right, np.eye(3), np.array([-0.5, 0.0, 0.0]))
    pairs = [StereoPair(n, 10 ** 18 + n * 10 ** 8, 10 ** 18 + n * 10 ** 8,
                        left=rng.integers(0, 256, (12, 16), np.uint8),
                        right=rng.integers(0, 256, (12, 16), np.uint8)) for n in range(3)]
    with tempfile.TemporaryDirectory() as aside:
        folder = write_pairs(rig, pairs, Path(aside) / 'made', storage,
                             compressed=storage == 'sqlite3')
        files = sorted(p for p in folder.rglob('*') if p.is_file())
        return tuple((p.name, p.read_bytes()) for p in files)


def _command_case(rng: Rng, folder: Path) -> Callable[[], object]:
    """Return ``replay`` of the first pairs of the sample, with damaged images."""
    bag, out = folder / 'bag', folder / 'out'
    damaged_copy(SAMPLE / 'bag', bag, pairs=4, damage=lambda data: damage_bytes(rng, data, 2),
                 which=int(rng.integers(8)))
    site, init = SAMPLE / 'site.yaml', SAMPLE / 'init.yaml'

    def replay() -> object:
        status = main(['replay', str(bag), '--site', str(site), '--init', str(init), '--no-plots',
                       '--out', str(out)])
        if status == 0:
            with (out / 'passes.csv').open(newline='') as file:
                speeds = [float(row['speed_mps']) for row in csv.DictReader(file)
                          if row['verdict'] == 'measured']
            if any(abs(v - _TRUE_MPS) > _WRONG * _TRUE_MPS for v in speeds):
                return f'a reading from garbage: {speeds} m/s'
            return 0
        left = [p.name for p in out.rglob('*') if p.is_file()] if out.is_dir() else []
        return status if status == 2 and not left else f'status {status}, left {left}'
    return replay


def _files_command_case(rng: Rng, folder: Path) -> Callable[[], object]:
    """Return the whole ``replay`` command with a damaged site, init or parameter file."""
    texts = {'--site': (SAMPLE / 'site.yaml').read_text(),
             '--init': (SAMPLE / 'init.yaml').read_text(), '--config': _parameters()}
    hurt = str(rng.choice(sorted(texts)))
    tree = yaml.safe_load(texts[hurt])
    texts[hurt] = yaml.safe_dump(damage_value(rng, damage_value(rng, tree)))
    arguments = ['replay', str(_short_bag()), '--no-plots', '--out', str(folder / 'out')]
    for option, text in texts.items():
        path = folder / f'{option[2:]}.yaml'
        path.write_text(text)
        arguments += [option, str(path)]

    def replay() -> object:
        status = main(arguments)
        out = folder / 'out'
        left = [p.name for p in out.rglob('*') if p.is_file()] if out.is_dir() else []
        return status if status == 0 or (status == 2 and not left) else (
            f'status {status}, left {left}')
    return replay


@lru_cache(maxsize=None)
def _short_bag() -> Path:
    folder = Path(tempfile.mkdtemp(prefix='fuzz-bag-'))
    return repeat_bag(SAMPLE / 'bag', folder / 'bag', 1, 1.0, pairs=3)


@lru_cache(maxsize=None)
def _parameters() -> str:
    """Return a small parameter file with sections of each kind."""
    return yaml.safe_dump({
        'particles': 60, 'verdict': {'least_pairs': 2}, 'noise': {}, 'road': {},
        'detectors': {'plane_sweep': {}}, 'trackers': {'kalman': {}}})


def _enforcement() -> str:
    """Return a parameter file with all parameters of enforcement."""
    return yaml.safe_dump({'enforcement': asdict(EnforcementConfig())})


@lru_cache(maxsize=None)
def _video() -> bytes:
    """Return a small video file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'video.avi'
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), 10.0, (32, 24))
        for level in range(0, 200, 40):
            writer.write(np.full((24, 32, 3), level, np.uint8))
        writer.release()
        return path.read_bytes()


def _map() -> bytes:
    labels = np.zeros((24, 32), np.uint8)
    labels[8:16] = 255
    return cv2.imencode('.png', labels)[1].tobytes()


_POLYGONS = """stereo_speed_map: 1
background: inaccessible
regions:
- {kind: pathway, polygon: [[0, 0], [30, 0], [30, 20], [0, 20]]}
"""
_TARGETS = """environment_targets: 1
targets:
- {id: 1, frame: 1, box: [3, 4, 10, 12], angle_deg: 0}
- {id: 2, frame: 3, box: [3.5, 4, 10, 12]}
"""
_BOXES = b'stamp_ns,left_px,top_px,width_px,height_px,score\n' + b''.join(
    b'%d,10.5,20,30,40,0.5\n' % (10 ** 18 + n) for n in range(4))

SUBJECTS: Mapping[str, Case] = {
    'site file': _yaml_case('site.yaml', (SAMPLE / 'site.yaml').read_text()
                            if SAMPLE.is_dir() else '', load_site),
    'init file': _yaml_case('init.yaml', (SAMPLE / 'init.yaml').read_text()
                            if SAMPLE.is_dir() else '', load_init),
    'parameter file': _yaml_case('config.yaml', _parameters(), load_pipeline_config),
    'parameters of one camera': _yaml_case(
        'config.yaml', 'particles: 100\n', lambda path: load_config(path, MonocularConfig)),
    'parameters of evidence': _yaml_case('config.yaml', _enforcement(), load_enforcement_config),
    'targets file': _yaml_case('targets.yaml', _TARGETS, load_targets),
    'polygons file': _yaml_case('map.yaml', _POLYGONS, load_regions),
    'boxes': _bytes_case('boxes.csv', lambda: _BOXES, load_boxes),
    'truth': _bytes_case('truth.csv', lambda: (SAMPLE / 'truth.csv').read_bytes(), read_truth),
    'image message': image_case,
    'image whose sizes lie': bomb_case,
    'CameraInfo': info_case,
    'MCAP bag': _bag_case('mcap'),
    'SQLite bag': _bag_case('sqlite3'),
    'ROS 1 bag': _bag_case('ros1'),
    'map image': _bytes_case('map.png', _map, load_map),
    'video file': _bytes_case('video.avi', _video, lambda path: sum(1 for _ in read_frames(path))
                              and None),
    'evidence folder': evidence_case(SAMPLE),
    'replay, damaged images': _command_case,
    'replay, damaged files': _files_command_case,
}
# Whole commands take a second instead of milliseconds, so they have fewer cases.
_SLOW = ('evidence folder', 'replay, damaged images', 'replay, damaged files')
_READERS = [name for name in SUBJECTS if name not in _SLOW]
_ORDER = _READERS * 6 + ['MCAP bag'] * 8 + [*_SLOW, 'evidence folder']
