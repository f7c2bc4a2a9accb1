# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Write files so that they appear only when complete: to a temporary place, then renamed."""
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
    Make the output folder and check that it is writable, before the work begins.

    :raises InputError: it is a file, cannot be made or is not writable.
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
    Yield a hidden folder whose files are moved into the output folder if the block succeeds.

    :param out_dir: output folder, made where it is missing; its other files stay.
    :param older: names of files of an older run, removed first, in this order. The first name
        marks a run as complete, so the new file of that name is moved last.
    :raises InputError: a folder or file cannot be written.
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
    Write files of a folder; the first is moved into place only when all have been written.

    :param out_dir: the folder, made where it is missing.
    :param files: contents by name; text is written as UTF-8, with its line ends unchanged.
    :param older: as for :func:`staged`.
    :raises InputError: a folder or file cannot be written.
    """
    with staged(out_dir, older) as aside:
        for name, content in files.items():
            data = content.encode('utf-8') if isinstance(content, str) else content
            (aside / name).write_bytes(data)


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """
    Return the text of a CSV file whose lines end with a line feed.

    :param columns: names for the header line.
    :param rows: cells as they are to be printed.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator='\n')
    writer.writerow(columns)
    writer.writerows(rows)
    return buffer.getvalue()
