"""Small capitals for captions: a 5 x 7 font of our own, one base-32 digit a row, the left pixel the highest bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_TABLE = (
    "A=ehhvhhh B=uhhuhhu C=ehggghe D=uhhhhhu E=vgguggv F=vgguggg G=ehgnhhf H=hhhvhhh I=e44444e J=72222ic "
    "K=hikokih L=ggggggv M=hrllhhh N=hhpljhh O=ehhhhhe P=uhhuggg Q=ehhhlid R=uhhukih S=fgge11u T=v444444 "
    "U=hhhhhhe V=hhhhha4 W=hhhllla X=hha4ahh Y=hhha444 Z=v1248gv 0=ehjlphe 1=4c4444e 2=eh1248v 3=v2421he "
    "4=26aiv22 5=vgu11he 6=68guhhe 7=v124888 8=ehhehhe 9=ehhf12c .=00000cc ,=0000c48 :=0cc0cc0 -=000v000 "
    "%=op248j3 /=01248g0 +=044v440 (=2488842 )=8422248 _=000000v"
)
_GLYPHS = dict(entry.split("=") for entry in _TABLE.split())
_ROWS, _COLUMNS, _ADVANCE = 7, 5, 6


def width(text: str, scale: int) -> int:
    """Width of a line of text in pixels."""
    return max(0, len(text) * _ADVANCE - 1) * scale


def write(
    picture: NDArray, text: str, at: tuple[int, int], scale: int, colour: tuple[int, int, int], centred: bool = False
) -> None:
    """Draw ``text`` in capitals into ``picture`` (H, W, 3), its top left (or top middle) at (row, column).

    Letters that the font lacks are drawn as blanks; what does not fit is cut off.
    """
    top, left = at
    if centred:
        left -= width(text, scale) // 2
    for index, letter in enumerate(text.upper()):
        rows = [int(digit, 32) for digit in _GLYPHS.get(letter, "0" * _ROWS)]
        bits = np.array([[row >> (_COLUMNS - 1 - i) & 1 for i in range(_COLUMNS)] for row in rows], bool)
        mask = bits.repeat(scale, axis=0).repeat(scale, axis=1)
        start = left + index * _ADVANCE * scale
        if start < 0:
            continue
        target = picture[top : top + mask.shape[0], start : start + mask.shape[1]]
        target[mask[: target.shape[0], : target.shape[1]]] = colour
