# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Usage: browser.py FOLDER. Install a headless Chromium for the tests of the page, unless present.

It comes from the npm registry (Playwright's own downloads are elsewhere) and is checked against
the hash below; an installed Chromium is used as well. Exit status 1, with one line, where none is
available.
"""
from __future__ import annotations

import base64
import hashlib
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tarfile
import tempfile
from typing import NoReturn
import urllib.request

VERSION = '147.0.0'
PACKAGE = f'chromium-{VERSION}.tgz'
REGISTRY = os.environ.get('NPM_CONFIG_REGISTRY', 'https://registry.npmjs.org').rstrip('/')
SHA512 = ('4ZKeAQQa8up2mt675qSitztLdbQrlf8BKdC5naeap+5M'
          'v1OV1OlJdPoU+EJC/p5sQUJUQmN4r+q5+EhaaOUHpQ==')
PARTS = {'chromium.br': 'chromium', 'al2023.tar.br': 'lib.tar', 'fonts.tar.br': 'fonts.tar'}
FONTS = """<?xml version="1.0"?>
<!DOCTYPE fontconfig SYSTEM "fonts.dtd">
<fontconfig><dir>{0}/fonts</dir><dir>/usr/share/fonts</dir><cachedir>{0}/cache</cachedir>
</fontconfig>
"""
INFLATE = ('const [a, b] = process.argv.slice(1); const fs = require("fs");'
           'fs.createReadStream(a).pipe(require("zlib").createBrotliDecompress())'
           '.pipe(fs.createWriteStream(b))')


def fail(line: str) -> NoReturn:
    """Print one line and exit with 1."""
    print(f'no browser for the tests of the page: {line}', file=sys.stderr)
    sys.exit(1)


def node() -> str:
    """Return the Node.js of Playwright, which can decompress Brotli."""
    try:
        import playwright
    except ModuleNotFoundError:
        fail('playwright is not installed; make venv')
    return str(Path(playwright.__file__).parent / 'driver' / 'node')


def download(target: Path) -> None:
    """Download the package and check its hash."""
    url = f'{REGISTRY}/@sparticuz/chromium/-/{PACKAGE}'
    digest = hashlib.sha512()
    try:
        with urllib.request.urlopen(url, timeout=60) as source, \
                target.open('wb') as out:  # noqa: S310
            while block := source.read(1 << 20):
                digest.update(block)
                out.write(block)
    except OSError as error:
        fail(f'{url}: {error}')
    if base64.b64encode(digest.digest()).decode() != SHA512:
        fail(f'{url}: another content than wanted')


def unpack(package: Path, folder: Path) -> None:
    """Unpack the browser, its libraries and a font."""
    engine = node()
    with tarfile.open(package) as archive:
        for name, part in PARTS.items():
            source = archive.extractfile(f'package/bin/{name}')
            if source is None:
                fail(f'{PACKAGE} lacks {name}')
            packed = folder / name
            with packed.open('wb') as out:
                shutil.copyfileobj(source, out)
            subprocess.run([engine, '-e', INFLATE, str(packed), str(folder / part)], check=True)
            packed.unlink()
    for part in ('lib.tar', 'fonts.tar'):
        with tarfile.open(folder / part) as archive:
            archive.extractall(folder)  # noqa: S202 (its hash is pinned)
        (folder / part).unlink()
    (folder / 'chromium').chmod(0o755)


def main() -> None:
    """Install the browser."""
    folder = Path(sys.argv[1]).resolve()
    stamp = folder / 'version'
    if stamp.is_file() and stamp.read_text() == f'{VERSION} at {folder}':
        return
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as aside:
        download(Path(aside, PACKAGE))
        inner = Path(aside, 'browser')
        inner.mkdir()
        unpack(Path(aside, PACKAGE), inner)
        inner.rename(folder)
    (folder / 'fonts.conf').write_text(FONTS.format(folder))
    stamp.write_text(f'{VERSION} at {folder}')
    print(f'Chromium {VERSION} in {folder}')


if __name__ == '__main__':
    main()
