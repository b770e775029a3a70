"""Refusals as the page shows them: beside the line that they are about."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from nuno.draw.lines import Stroke, line_at, piece_of
from nuno.seen.sight import Sight
from nuno_schemas.errors import BadInput

_LINE = re.compile(r"lines\[(\d+)\]")
_TRIANGLE = re.compile(r"triangle (\d+)")


def beside(error: BadInput, strokes: Sequence[Stroke], which: Sequence[int], sight: Sight) -> BadInput:
    """The same refusal, its field that of one of the page's lines, of which those of the numbers `which` were tried.

    Where a triangle is to blame, through which two lines go that may not, the later one of them is shown.
    """
    line, triangle = _LINE.search(error.field or ""), _TRIANGLE.search(str(error.value))
    if line is not None and int(line[1]) < len(which):
        number = which[int(line[1])]
    elif triangle is not None:
        piece = piece_of(sight, int(sight.faces[strokes[which[0]].points[0][0], 0]))
        number = which[line_at([strokes[i] for i in which], piece, int(triangle[1]), sight)]
    else:
        return error
    return replace(error, field=f"lines[{number}]")
