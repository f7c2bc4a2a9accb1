# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A report as one self-contained HTML file with embedded pictures."""
from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path
from typing import Sequence

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure

from .plots import png_of

_TEMPLATES = Path(__file__).with_name('templates')
_DPI = 90


@dataclass(frozen=True)
class Picture:
    """
    A picture of a report.

    :param caption: what it shows.
    :param data: content of a PNG or JPEG file.
    :param kind: ``png`` or ``jpeg``.
    """

    caption: str
    data: bytes
    kind: str = 'png'

    @property
    def uri(self) -> str:
        """Return the picture as a data URI."""
        return f'data:image/{self.kind};base64,{base64.b64encode(self.data).decode()}'

    @classmethod
    def of(cls, caption: str, figure: Figure) -> Picture:
        """Return a plot as a picture; the same plot gives the same bytes."""
        return cls(caption, png_of(figure, _DPI))


@dataclass(frozen=True)
class Section:
    """
    A part of a report.

    :param heading: its title.
    :param text: its paragraphs.
    :param columns: column headings of its table; empty for no table.
    :param rows: cells of the table.
    :param large: whether the cells are set in large type.
    :param pictures: pictures below the table.
    :param details: text that the reader can unfold.
    """

    heading: str
    text: Sequence[str] = ()
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[object]] = ()
    large: bool = False
    pictures: Sequence[Picture] = ()
    details: str = ''


def page_html(title: str, sections: Sequence[Section]) -> str:
    """Return a report as the text of an HTML file, with all texts escaped."""
    environment = Environment(loader=FileSystemLoader(_TEMPLATES), autoescape=True,
                              undefined=StrictUndefined, trim_blocks=True)
    return environment.get_template('page.html').render(title=title, sections=sections)
