"""What tells a person's front from the back: a face, a neckline, an open jacket, a bare chest.

All is painted by where a surface point lies on the body at rest: x to its left, y up, z forward,
in metres.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

BEARD_SHARE, GLASSES_SHARE, CAP_SHARE = 0.3, 0.15, 0.2
OPEN_SHARE, NECKLINE_SHARE, STRIPE_SHARE, PRINT_SHARE = 0.3, 0.35, 0.25, 0.25
"""How many upper garments are open in front, show the neck, have a row of buttons or a tie, and a
print."""

PIXELATED_SHARE = 0.2
"""How many visible faces are pixelated or blurred, as privacy asks."""

_EYE_DISTANCE = 0.03
_LIPS = np.array([60, 60, 150])


def _blend(
    colour: NDArray[np.float32],
    where: NDArray[np.bool_],
    paint: NDArray[np.floating],
    share: float,
) -> None:
    colour[where] += np.float32(share) * (paint.astype(np.float32) - colour[where])


def paint_face(
    colour: NDArray[np.float32],
    rest: NDArray[np.float32],
    eyes: NDArray[np.float32],
    hair: NDArray[np.floating],
    bearded: bool,
    generator: np.random.Generator,
) -> None:
    """Paint eyes, brows, mouth, and perhaps a beard and glasses on skin, in place.

    Parameters
    ----------
    colour : (P, 3) float32 array
        BGR of the points.
    rest : (P, 3) float32 array
        Where they lie on the body at rest.
    eyes : (3,) float32 array
        The middle between the eyes.
    hair : (3,) array
        BGR of brows and beard.
    bearded : bool
        Whether a beard may grow.
    generator : numpy.random.Generator
    """
    x, y, z = (rest - eyes).T
    aside = np.abs(x)
    front = z > -0.045
    flesh = colour.mean(axis=0) if len(colour) else hair
    if bearded and generator.random() < BEARD_SHARE:
        chin = (y < -0.052) & (y > -0.14) & (z > -0.09)
        moustache = front & (np.abs(y + 0.055) < 0.007) & (aside < 0.03)
        _blend(colour, chin | moustache, hair, generator.uniform(0.2, 0.9))
    socket = front & (((aside - _EYE_DISTANCE) / 0.02) ** 2 + (y / 0.014) ** 2 < 1)
    _blend(colour, socket, flesh * 0.5, generator.uniform(0.3, 0.8))
    white = front & (((aside - _EYE_DISTANCE) / 0.013) ** 2 + (y / 0.006) ** 2 < 1)
    _blend(colour, white, np.full(3, 220.0), generator.uniform(0.2, 0.8))
    pupil = front & ((aside - _EYE_DISTANCE) ** 2 + y**2 < 0.006**2)
    _blend(colour, pupil, np.full(3, 30.0), 0.9)
    brow = front & (np.abs(y - 0.023 + 0.1 * (aside - _EYE_DISTANCE)) < 0.005) & (aside < 0.052)
    _blend(colour, brow & (aside > 0.01), hair, generator.uniform(0.4, 0.9))
    nostrils = front & (np.abs(y + 0.042) < 0.005) & (aside < 0.015)
    _blend(colour, nostrils, flesh * 0.45, generator.uniform(0.3, 0.8))
    lips = front & ((x / 0.026) ** 2 + ((y + 0.07) / 0.009) ** 2 < 1)
    _blend(colour, lips, _LIPS * generator.uniform(0.6, 1.2), generator.uniform(0.3, 0.8))
    if generator.random() < GLASSES_SHARE:
        round_eyes = ((aside - _EYE_DISTANCE) / 0.027) ** 2 + ((y + 0.003) / 0.021) ** 2
        bridge = (np.abs(y) < 0.004) & ((aside < 0.01) | (aside > 0.055)) & (z > -0.1)
        shown = (round_eyes < 1) & ((round_eyes > 0.6) | (generator.random() < 0.4)) & front
        _blend(colour, shown | bridge, np.full(3, 25.0), 0.95)


def scalp_of(
    rest: NDArray[np.float32],
    eyes: NDArray[np.float32],
    slope: float,
    generator: np.random.Generator,
) -> NDArray[np.bool_]:
    """Which points hair or a cap covers: above the forehead, and by ``slope`` lower behind."""
    _, y, z = (rest - eyes).T
    return np.asarray(y > generator.uniform(0.03, 0.06) + slope * np.minimum(0, z + 0.04))


def paint_bare_trunk(
    colour: NDArray[np.float32],
    rest: NDArray[np.float32],
    up: NDArray[np.float32],
    hair: NDArray[np.floating],
    hairy: bool,
    generator: np.random.Generator,
) -> None:
    """Paint nipples, navel, perhaps hair in front, and the line of the spine behind, in place.

    ``up`` is the height of the points as a share of the body's; the others as for the face.
    """
    x, z = rest[:, 0], rest[:, 2]
    aside = np.abs(x)
    front, back = z > 0.06, z < 0.0
    if hairy and generator.random() < 0.5:
        chest = front & (aside < 0.09) & (up > 0.6 + 0.9 * aside) & (up < 0.78)
        patchy = np.sin(170 * x) + np.sin(190 * rest[:, 1]) > generator.uniform(-1.5, 0.5)
        _blend(colour, chest & patchy, hair, generator.uniform(0.1, 0.5))
    nipples = front & ((aside - 0.085) ** 2 + (1.75 * (up - 0.725)) ** 2 < 0.011**2)
    _blend(colour, nipples, colour.mean(axis=0) * (0.6, 0.6, 0.75), 0.8)
    navel = front & (x**2 + (1.75 * (up - 0.605)) ** 2 < 0.009**2)
    _blend(colour, navel, colour.mean(axis=0) * 0.35, 0.9)
    midline = front & (aside < 0.006) & (up > 0.62) & (up < 0.74)
    _blend(colour, midline, colour.mean(axis=0) * 0.75, generator.uniform(0, 0.6))
    spine = back & (aside < 0.009) & (up > 0.57) & (up < 0.8)
    _blend(colour, spine, colour.mean(axis=0) * 0.6, generator.uniform(0.1, 0.7))


def paint_upper_garment(
    colour: NDArray[np.float32],
    rest: NDArray[np.float32],
    up: NDArray[np.float32],
    flesh: NDArray[np.floating],
    cloths: tuple[NDArray[np.float32], NDArray[np.float32]],
    straps: NDArray[np.floating] | None,
    generator: np.random.Generator,
) -> None:
    """Paint what is before the chest, in place.

    Parameters
    ----------
    colour, rest, up
        As for the trunk.
    flesh : (3,) array
        BGR of the neck.
    cloths : pair of (P, 3) float32 arrays
        Colours of what is worn below, and of prints.
    straps : (3,) array, optional
        BGR of what hangs on the back; its straps run over the chest.
    generator : numpy.random.Generator
    """
    x, z = rest[:, 0], rest[:, 2]
    aside, front = np.abs(x), z > 0.03
    below, printed = cloths
    if generator.random() < PRINT_SHARE:
        side = front if generator.random() < 0.75 else z < 0.0
        centre, half = generator.uniform(0.66, 0.76), generator.uniform(0.02, 0.07)
        patch = side & (aside < 1.75 * half) & (np.abs(up - centre) < half)
        colour[patch] = printed[patch]
    if generator.random() < OPEN_SHARE:
        width = generator.uniform(0.01, 0.1) + generator.uniform(-0.3, 0.3) * (up - 0.65)
        gap = front & (aside < width)
        colour[gap] = below[gap]
        _blend(colour, front & (np.abs(aside - width) < 0.006), np.full(3, 20.0), 0.5)
    if generator.random() < NECKLINE_SHARE:
        depth, slope = generator.uniform(0.74, 0.8), generator.uniform(0.5, 1.6)
        neck = front & (aside < slope * np.maximum(0, up - depth)) & (up < 0.86)
        colour[neck] = flesh
    if generator.random() < STRIPE_SHARE:
        tone = np.full(3, generator.uniform(0, 255))
        line = (
            front & (aside < generator.uniform(0.004, 0.025)) & (up > generator.uniform(0.5, 0.7))
        )
        _blend(colour, line, tone, generator.uniform(0.4, 0.9))
    if straps is not None:
        band = front & (np.abs(aside - 0.11) < 0.022) & (up > generator.uniform(0.6, 0.7))
        colour[band] = straps


def pixelate(
    colour: NDArray[np.float32], face: NDArray[np.bool_], generator: np.random.Generator
) -> NDArray[np.float32]:
    """Make a face in a picture ``(H, W, 3)`` unrecognisable, where ``(H, W)`` says it is."""
    rows, columns = np.nonzero(face)
    if len(rows) == 0:
        return colour
    top, left = rows.min(), columns.min()
    part = colour[top : rows.max() + 1, left : columns.max() + 1]
    on = face[top : rows.max() + 1, left : columns.max() + 1]
    height, width = part.shape[:2]
    cell = max(height, width) / generator.uniform(2.5, 9)
    if generator.random() < 0.7:
        size = (max(1, round(width / cell)), max(1, round(height / cell)))
        weight = np.maximum(cv2.resize(on.astype(np.float32), size, interpolation=3), 1e-3)
        coarse = cv2.resize(part * on[..., None], size, interpolation=3).reshape(*weight.shape, 3)
        coarse = coarse / weight[..., None]
        hidden = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST)
    else:
        weight = np.maximum(cv2.GaussianBlur(on.astype(np.float32), (0, 0), cell / 2), 1e-3)
        hidden = cv2.GaussianBlur(part * on[..., None], (0, 0), cell / 2) / weight[..., None]
    result = colour.copy()
    result[top : rows.max() + 1, left : columns.max() + 1][on] = hidden.reshape(*part.shape)[on]
    return result
