"""What notebooks show of results, reports, trajectories and checks: their text as a table, and a small picture."""

from __future__ import annotations

from base64 import b64encode
from html import escape
from sys import modules


def notebook_html(shown: object) -> str:
    """Return what a notebook shows of an object, its `_repr_html_`.

    Each line of its text is a row; what stands before the first colon is its head. Beside them is a picture where there
    is something to draw, and Matplotlib to draw it.
    """
    rows = "".join(f"<tr>{_cells(line)}</tr>" for line in str(shown).splitlines())
    table = f"<table>{rows}</table>"
    png = modules["safe_ompl"].view.small_picture(shown)  # by the public door: no room here is below the pictures
    if not png:
        return table
    image = f'<img alt="" src="data:image/png;base64,{b64encode(png).decode()}"/>'
    return f'<div style="display: flex; align-items: center; gap: 1em">{image}{table}</div>'


def _cells(line: str) -> str:
    head, _, rest = line.partition(": ")
    left = 'style="text-align: left"'
    if not rest:
        return f'<td colspan="2" {left}>{escape(line.strip())}</td>'
    return f"<th {left}>{escape(head.strip())}</th><td {left}>{escape(rest)}</td>"
