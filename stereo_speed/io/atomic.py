# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Files that appear in their place only when they are whole: written aside, then renamed."""
from __future__ import annotations

from contextlib import contextmanager
import csv
import io
import os
from pathlib import Path
import tempfile
from typing import Any, Iterable, Iterator, Mapping, Sequence, Union

from ..core.errors import InputError

PathLike = Union[str, Path]


def prepare_folder(out_dir: PathLike) -> Path:
    """
    Make the output folder and try that it can be written, before the work begins.

    :raises InputError: it is a file, or cannot be made or written.
    """
    folder = Path(out_dir)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(folder, 'output folder', error.strerror, 'a writable folder') from None
    return folder


@contextmanager
def staged(out_dir: PathLike, older: Sequence[str] = ()) -> Iterator[Path]:
    """
    Give a hidden folder to write into, whose files are moved into another when all went well.

    :param out_dir: that other folder, made when it is not there; its other files stay.
    :param older: names of the files of an older run there, removed first, in this order. The
        first of them tells that a run is complete, so the new one of this name comes last.
    :raises InputError: a folder or file that cannot be written.
    """
    where = folder = prepare_folder(out_dir)
    try:
        with tempfile.TemporaryDirectory(prefix='.partial-', dir=folder) as aside:
            yield Path(aside)
            for name in older:
                (folder / name).unlink(missing_ok=True)
            names = sorted(os.listdir(aside), key=lambda name: (name in older[:1], name))
            for name in names:
                where = folder / name
                os.replace(Path(aside, name), where)
    except OSError as error:
        raise InputError(where, 'output', error.strerror or error,
                         'a place that can be written') from None


def write_whole(out_dir: PathLike, files: Mapping[str, Union[str, bytes]],
                older: Sequence[str] = ()) -> None:
    """
    Write files of a folder, all of them aside before the first is moved in.

    :param out_dir: the folder, made when it is not there.
    :param files: contents by name; text is written as UTF-8, its line ends as they are.
    :param older: as for :func:`staged`.
    :raises InputError: a folder or file that cannot be written.
    """
    with staged(out_dir, older) as aside:
        for name, content in files.items():
            data = content.encode('utf-8') if isinstance(content, str) else content
            (aside / name).write_bytes(data)


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """
    Give the text of a CSV file, its lines ended by a line feed.

    :param columns: names of the first line.
    :param rows: cells as they are to be printed.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator='\n')
    writer.writerow(columns)
    writer.writerows(rows)
    return buffer.getvalue()
