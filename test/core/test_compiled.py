# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Kernels are chosen by installed packages and by request, and the choice is reported."""
from __future__ import annotations

import ast
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest

from stereo_speed.core import compiled
from stereo_speed.core.compiled import kernel, kernels


@pytest.fixture(autouse=True)
def undecided(monkeypatch):
    monkeypatch.delenv(compiled.VARIABLE, raising=False)
    kernels.cache_clear()
    yield
    kernels.cache_clear()


TYPES = '(f8[:,::1], f8)'


def plain_total(values, more):
    """Sum in plain Python."""
    return 'plain', float(np.sum(values)) + more


def loop_total(values, more):
    total = more
    for row in values:
        for value in row:
            total += value
    return 'loop', total


def test_plain_kernels_can_be_requested(monkeypatch):
    monkeypatch.setenv(compiled.VARIABLE, 'plain')
    assert kernel(plain_total, TYPES)(loop_total)([[1.0, 2.0]], 4) == ('plain', 7.0)
    assert str(kernels()) == 'plain numpy (STEREO_SPEED_KERNELS=plain)'


def test_plain_kernels_are_used_without_numba_with_the_reason(monkeypatch):
    monkeypatch.setitem(sys.modules, 'numba', None)
    assert kernel(plain_total, TYPES)(loop_total)([[1.0, 2.0]], 4) == ('plain', 7.0)
    assert not kernels().compiled
    assert 'numba' in kernels().why


def test_requested_compilation_without_numba_is_an_error(monkeypatch):
    monkeypatch.setitem(sys.modules, 'numba', None)
    monkeypatch.setenv(compiled.VARIABLE, 'compiled')
    with pytest.raises(ImportError):
        kernels()


def test_invalid_choice_is_an_error(monkeypatch):
    monkeypatch.setenv(compiled.VARIABLE, 'fast')
    with pytest.raises(ValueError, match="'fast', wanted one of compiled, plain"):
        kernels()


def test_compiled_kernels_report_the_version_of_numba():
    numba = pytest.importorskip('numba')
    total = kernel(plain_total, TYPES)(loop_total)
    assert total([[1.0, 2.0]], 4) == ('loop', 7.0)
    assert str(kernels()) == f'compiled (numba {numba.__version__})'
    assert total.__doc__ == plain_total.__doc__


def read_only(values):
    values = values.copy()
    values.flags.writeable = False
    return values


def unaligned(values):
    out = np.frombuffer(b'.' + values.tobytes(), np.uint8)[1:].view(values.dtype)
    return out.reshape(values.shape)


@pytest.mark.parametrize('other', [
    read_only, unaligned, np.asfortranarray, lambda a: np.repeat(a, 2, axis=1)[:, ::2],
    lambda a: a.astype(np.longdouble), np.ndarray.tolist])
def test_one_compiled_loop_serves_every_array_layout(other):
    pytest.importorskip('numba')
    total = kernel(plain_total, TYPES)(loop_total)
    values = np.random.default_rng(6).standard_normal((7, 301))
    wanted = total(values, 0.5)
    assert total(other(values), 0.5) == wanted
    assert total(other(values), np.float32(0.5)) == wanted


@pytest.mark.slow
def test_bits_do_not_depend_on_history_or_the_compiling_process(
        fresh_process, tmp_path, monkeypatch):
    pytest.importorskip('numba')
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path))
    compiled, loaded, after_others = (
        fresh_process(BITS, history) for history in ('', '', 'others'))
    assert len(compiled.splitlines()) == 2
    assert loaded == compiled
    assert after_others == compiled


# Two kernels with helpers: exact results, at first or after arrays of other layouts.
BITS = """
import hashlib
import sys
import numpy as np
from stereo_speed.detection.patch_kernels import shifted
from stereo_speed.tracking.observation_kernels import views

def strided(value):
    if not isinstance(value, np.ndarray):
        return value
    out = np.repeat(value, 2, axis=-1)[..., ::2]
    out.flags.writeable = False
    return out

rng = np.random.default_rng(1)
crop = rng.uniform(0, 255, (90, 160)).astype(np.float32)
wide = rng.uniform(0, 255, (3, 9, 113)).astype(np.float32)
for one, args in (
        (views, (crop, crop / 255, crop + 1, crop / 128, np.zeros((2, 2)),
                 rng.uniform(-2, 92, (2, 2, 640)), rng.standard_normal((2, 6, 640, 2)),
                 rng.uniform(1, 6, (2, 2)), 2.2, 10.0)),
        (shifted, (wide, wide[::-1].copy(), np.full(3, 14), np.ones((3, 85), bool), 4))):
    if sys.argv[2]:
        one(*map(strided, args))
    results = one(*args)
    results = results if isinstance(results, tuple) else (results,)
    print(hashlib.sha256(b''.join(r.tobytes() for r in results)).hexdigest())
"""


@pytest.mark.slow
def test_no_pair_waits_for_the_compiler_after_warming_up(fresh_process):
    pytest.importorskip('numba')
    told = fresh_process(WARM).split()
    assert int(told[0]) > 5  # kernels that this needs
    assert told[1:] == []


WARM = """
from pathlib import Path
import subprocess
import sys
from numba.core.dispatcher import Dispatcher
from stereo_speed.core.compiled import REGISTRY, warm_up
from stereo_speed.io.bags import StereoBag
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.pipeline.run import run
from stereo_speed.site.file import load_site

sample = Path(sys.argv[1])
with StereoBag(sample / 'bag') as bag:
    rig, pairs = bag.rig, list(bag.pairs())
pipeline = MeasuringSite.of(load_site(sample / 'site.yaml'), rig).pipeline(PipelineConfig())
warm_up()
late, compile_ = [], Dispatcher.compile
Dispatcher.compile = lambda self, types: late.append(self.__name__) or compile_(self, types)
run(pipeline, pairs[:4])
print(len(REGISTRY), *late)
"""


@pytest.fixture
def fresh_process(sample):
    def call(program, *more):
        return subprocess.run([sys.executable, '-c', program, str(sample), *more], check=True,
                              text=True, capture_output=True, timeout=120).stdout
    return call


def test_constants_of_a_loop_are_in_its_own_file():
    """Compiled code is cached until that file changes; constants from elsewhere might be stale."""
    package = Path(compiled.__file__).parents[1]
    files = [path for path in package.rglob('*.py') if '@kernel(' in path.read_text()]
    assert files
    for path in files:
        tree = ast.parse(path.read_text())
        imported = {alias.asname or alias.name for node in ast.walk(tree)
                    if isinstance(node, ast.ImportFrom) for alias in node.names}
        for loop in ast.walk(tree):
            if isinstance(loop, ast.FunctionDef) and loop.decorator_list:
                body = {node.id for line in loop.body for node in ast.walk(line)
                        if isinstance(node, ast.Name)}
                kept = [ast.unparse(d) for d in loop.decorator_list]
                if any(d == 'inlined' or d.startswith('kernel(') for d in kept):
                    assert not body & imported, (path.name, loop.name, body & imported)
