"""Sprites: simulated people in colour, cut out, to be put before photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from app.facing import azimuth_deg
from app.vision.resampling import resize
from index.build.avatars import INDEX_AVATARS, make_avatars
from index.build.body import Avatar, Retargeting, pose_transforms, posed_points, retarget
from index.build.camera import sample_views
from index.build.motion import read_manifest
from index.build.poses import Poses, farthest_points, joints_of, read_poses
from index.build.render import skin
from index.skeleton import POINTS, camera_rotation, project
from scripts.refinement.bags import with_bags
from scripts.refinement.features import (
    CAP_SHARE,
    PIXELATED_SHARE,
    paint_bare_trunk,
    paint_face,
    paint_upper_garment,
    pixelate,
    scalp_of,
)
from scripts.refinement.shading import rasterise, vertex_normals

ROWS = 320
"""Height at which sprites are drawn, in pixels, where nothing else is asked for."""

SUPERSAMPLING = 2
FALLEN_SHARE, FALLEN_DEG = 0.15, 45.0
"""How many lean or lie, and the standard deviation of their roll."""

WALKING_SHARE, COVERING_SHARE = 0.4, 0.35
"""How many poses are of walks, and how many of the set that covers all that people do; the others
are drawn as they come."""

MIXED_SHARE = 0.5
"""How many poses have a limb or more of another pose: arms and legs do what no clip holds."""

UNCLOTHED_SHARE, BARE_SHARE = 0.22, 0.45
"""How many have no garments but painted ones, and how many of these a bare trunk."""

BALD_SHARE = 0.15
"""How many of them have no hair either."""

LIMB_BONES = tuple(
    (tuple(f"{side}{bone}" for bone in bones), trunk)
    for side in ("Left", "Right")
    for bones, trunk in (
        (("Arm", "ForeArm", "Hand"), "Spine1"),
        (("UpLeg", "Leg", "Foot", "ToeBase"), "Hips"),
    )
)
"""The bones of each limb, and the bone of the trunk that carries it."""

_SKINS = np.array([[150, 178, 224], [120, 150, 205], [95, 125, 185], [60, 85, 140], [40, 58, 95]])
_HAIRS = np.array([[25, 25, 30], [35, 50, 75], [70, 110, 150], [120, 125, 130], [20, 30, 45]])


@dataclass(frozen=True)
class Sprite:
    """One simulated person.

    Parameters
    ----------
    colour : (h, w, 3) uint8 array
        BGR; beyond the person its nearest colours run on.
    cover : (h, w) float32 array
        Share of each pixel that the person and what he or she carries cover, 0 to 1.
    own : (h, w) float32 array
        The same of the person alone, with what is on the back, without what a hand carries.
    points : (24, 2) float64 array
        Where the skeleton's points are, in pixels; rows are ``POINT_NAMES``.
    azimuth_deg : float
        From where the camera sees shoulders and hips, as :func:`app.facing.azimuth_deg` has it; of
        the upright person, however far this one leans.
    """

    colour: NDArray[np.uint8]
    cover: NDArray[np.float32]
    own: NDArray[np.float32]
    points: NDArray[np.float64]
    azimuth_deg: float

    def __post_init__(self) -> None:
        if self.colour.shape != (*self.cover.shape, 3) or self.own.shape != self.cover.shape:
            raise ValueError(
                "expected colour, cover and own of equal size, got "
                f"{self.colour.shape}, {self.cover.shape} and {self.own.shape}"
            )
        if self.points.shape != (POINTS, 2):
            raise ValueError(f"expected {POINTS} points, got {self.points.shape}")


def pieces_of(triangles: NDArray[np.int32], vertices: int) -> NDArray[np.int32]:
    """Number the connected surfaces of a mesh; one number for each triangle."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    links = coo_array((np.ones(len(edges)), edges.T), shape=(vertices, vertices))
    labels = connected_components(links, directed=False)[1]
    return np.asarray(labels[triangles[:, 0]], np.int32)


def tops_of(avatar: Avatar, pieces: NDArray[np.int32]) -> NDArray[np.float64]:
    """How high the top of each surface lies at rest: 0 at the sole, 1 at the crown."""
    heights = avatar.vertices[:, 1].astype(np.float64)
    highest = heights[avatar.triangles].max(axis=1)
    tops = np.full(pieces.max() + 1, -np.inf)
    np.maximum.at(tops, pieces, highest)
    return np.asarray((tops - heights.min()) / (heights.max() - heights.min()), np.float64)


class Casting:
    """All avatars and motions, from which sprites are drawn.

    Parameters
    ----------
    shared : Path
        Holds ``mocap`` and ``garments``.
    textures : sequence of (H, W, 3) uint8 arrays
        Photographs whose pieces are printed on clothes.
    rows : int
        Height at which sprites are drawn, in pixels.
    """

    def __init__(
        self, shared: Path, textures: Sequence[NDArray[np.uint8]], rows: int = ROWS
    ) -> None:
        self.rows = rows
        self.poses: Poses = read_poses(shared / "mocap", read_manifest(shared / "mocap"))[0]
        self.avatars = make_avatars(INDEX_AVATARS, shared / "garments")
        self.textures = textures
        joints = joints_of(self.poses, self.avatars[0])
        flat = joints.reshape(len(joints), -1)
        self._kinds = (
            np.flatnonzero(self.poses.action == self.poses.actions.index("walk")),
            farthest_points(flat, 600),
            np.arange(len(self.poses)),
        )
        self._pieces = [pieces_of(a.triangles, len(a.vertices)) for a in self.avatars]
        self._tops = [
            tops_of(avatar, pieces)
            for avatar, pieces in zip(self.avatars, self._pieces, strict=True)
        ]
        unclothed = np.array([a.closed == len(a.triangles) for a in self.avatars])
        shares = np.where(unclothed, UNCLOTHED_SHARE, 1 - UNCLOTHED_SHARE)
        self._shares = shares / np.where(unclothed, unclothed.sum(), (~unclothed).sum())
        self._retargetings: dict[tuple[int, int], Retargeting] = {}

    def sprite(self, generator: np.random.Generator) -> Sprite:
        """Draw one person: body, clothes, pose, camera, light and colours by chance."""
        which = int(generator.choice(len(self.avatars), p=self._shares))
        rest = 1 - WALKING_SHARE - COVERING_SHARE
        kind = int(generator.choice(3, p=(WALKING_SHARE, COVERING_SHARE, rest)))
        row = int(generator.choice(self._kinds[kind]))
        avatar, clip = self.avatars[which], int(self.poses.clip[row])
        if (clip, which) not in self._retargetings:
            self._retargetings[clip, which] = retarget(self.poses.clips[clip], avatar)
        rotations = self.poses.rotations(row)
        if generator.random() < MIXED_SHARE:
            rotations = self._with_other_limbs(row, rotations, generator)
        moved = pose_transforms(avatar, self._retargetings[clip, which], rotations)
        points = posed_points(avatar, moved)[0]
        vertices = skin(
            avatar.vertices, avatar.influences, avatar.weights, moved[0].astype(np.float32)
        )
        vertices, triangles, held = with_bags(vertices, avatar, moved[0], generator)
        camera = sample_views(1, generator)[0]
        roll = float(camera["roll_deg"])
        if generator.random() < FALLEN_SHARE:
            roll += generator.normal(0, FALLEN_DEG)
        elevation = float(camera["elevation_deg"]) * (0.5 if generator.random() < 0.5 else 1.0)
        azimuth = float(camera["azimuth_deg"])
        turn = camera_rotation(azimuth, elevation, roll).T
        facing = float(azimuth_deg(points @ camera_rotation(azimuth, elevation).T))
        seen = (vertices @ turn, points @ turn, facing)
        return self._drawn(which, seen, (triangles, held), float(camera["distance"]), generator)

    def _with_other_limbs(
        self, row: int, rotations: NDArray[np.float64], generator: np.random.Generator
    ) -> NDArray[np.float64]:
        """Give a pose's world rotations ``(1, B, 3, 3)`` some arms and legs of other poses."""
        mixed = rotations.copy()
        names = self.poses.clips[self.poses.clip[row]].bones
        for limb, trunk in LIMB_BONES:
            if generator.random() > 0.5:
                continue
            other = int(generator.choice(self._kinds[1]))
            donor = self.poses.clips[self.poses.clip[other]].bones
            turns = self.poses.rotations(other)[0]
            between = rotations[0, names.index(trunk)] @ turns[donor.index(trunk)].T
            for bone in limb:
                mixed[0, names.index(bone)] = between @ turns[donor.index(bone)]
        return mixed

    def _drawn(
        self,
        which: int,
        seen: tuple[NDArray[np.float64], NDArray[np.float64], float],
        surface: tuple[NDArray[np.int32], bool],
        distance: float,
        generator: np.random.Generator,
    ) -> Sprite:
        """Draw a body as ``seen``: vertices and points in camera axes, and the azimuth.

        ``surface`` is its triangles, and whether a hand carries those that are no avatar's.
        """
        avatar = self.avatars[which]
        turned, points, facing = seen
        triangles, held = surface
        plane = project(turned, distance)
        low, high = plane.min(axis=0), plane.max(axis=0)
        scale = (
            self.rows * SUPERSAMPLING / max(float(high[1] - low[1]), 0.7 * float(high[0] - low[0]))
        )
        margin = 4 * SUPERSAMPLING
        places = ((plane - low) * scale + margin).astype(np.float32)
        joints = (project(points, distance) - low) * scale + margin
        width, height = (np.ceil((high - low) * scale / 2).astype(int) * 2 + 2 * margin).tolist()
        corners: NDArray[np.float32] = turned.astype(np.float32)
        normals = vertex_normals(corners, triangles)
        # Bags have no rest pose: they are coloured by where they are.
        rest = np.concatenate([avatar.vertices, corners[len(avatar.vertices) :]])
        values = np.concatenate([rest, normals], axis=1)
        shown, buffer = rasterise(
            places, np.ascontiguousarray(corners[:, 2]), triangles, values, height, width
        )
        on = shown >= 0
        colour = np.zeros((height, width, 3), np.float32)
        colour[on] = self._colours(which, shown[on], buffer[on], generator)
        if generator.random() < PIXELATED_SHARE:
            face = np.zeros((height, width), bool)
            face[on] = self._is_face(which, shown[on], buffer[on, :3])
            colour = pixelate(colour, face, generator)
        small = (width // SUPERSAMPLING, height // SUPERSAMPLING)
        cover = resize(on.astype(np.float32), *small)
        person = on & (shown < len(avatar.triangles)) if held else on
        own = resize(person.astype(np.float32), *small)
        summed = resize(colour, *small)
        # Colours run on past the outline, so that a blurred or enlarged sprite has no dark rim.
        around = [cv2.GaussianBlur(array, (0, 0), 2.0) for array in (summed, cover)]
        inside = summed / np.maximum(cover, 1e-3)[..., None]
        beyond = around[0] / np.maximum(around[1], 1e-3)[..., None]
        filled = np.where(cover[..., None] > 0.05, inside, beyond)
        joints = (joints + 0.5) / SUPERSAMPLING - 0.5
        return Sprite(np.clip(filled, 0, 255).astype(np.uint8), cover, own, joints, facing)

    def _is_face(
        self, which: int, triangles: NDArray[np.int32], rest: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        """Which of some points at rest places ``(P, 3)`` are before the ears, chin to forehead."""
        nose, ears = self.avatars[which].face[0], self.avatars[which].face[3:].mean(axis=0)
        beside = np.abs(rest[:, 1] - nose[1] - 0.02) < 0.11
        own = triangles < len(self.avatars[which].triangles)
        return np.asarray(own & beside & (rest[:, 2] > ears[2] - 0.02))

    def _colours(
        self,
        which: int,
        triangles: NDArray[np.int32],
        values: NDArray[np.float32],
        generator: np.random.Generator,
    ) -> NDArray[np.float32]:
        """Lit colours ``(P, 3)`` of pixels that show some triangles at rest places ``values``."""
        avatar = self.avatars[which]
        rest, normals = values[:, :3], values[:, 3:]
        body, bag = triangles < avatar.closed, triangles >= len(avatar.triangles)
        colour = np.empty((len(rest), 3), np.float32)
        flesh = _SKINS[generator.integers(len(_SKINS))] * generator.uniform(0.8, 1.1)
        hair = _HAIRS[generator.integers(len(_HAIRS))] * generator.uniform(0.85, 1.15)
        worn = self._cloth(rest[:1], generator)[0] if bag.any() else None
        colour[body] = flesh
        if bag.any():
            colour[bag] = self._cloth(rest[bag], generator)
        bottom = float(avatar.vertices[:, 1].min())
        up = (rest[:, 1] - bottom) / (float(avatar.vertices[:, 1].max()) - bottom)
        man = avatar.name.startswith("m")
        eyes = avatar.face[1:3].mean(axis=0).astype(np.float32)
        head = body & (np.abs(rest[:, 1] - eyes[1]) < 0.16) & (np.abs(rest[:, 0]) < 0.12)
        faced = colour[head]
        paint_face(faced, rest[head], eyes, hair, man, generator)
        colour[head] = faced
        upper = np.zeros(len(rest), bool)
        if avatar.closed == len(avatar.triangles):
            upper = self._paint_clothes(colour, rest, up, body, (hair, eyes, man), generator)
        upper |= self._colour_garments(colour, which, triangles, rest, up, hair, generator)
        if upper.any():
            part = colour[upper]
            cloths = (self._cloth(rest[upper], generator), self._cloth(rest[upper], generator))
            paint_upper_garment(part, rest[upper], up[upper], flesh, cloths, worn, generator)
            colour[upper] = part
        if generator.random() < CAP_SHARE:
            cap = ~bag & scalp_of(rest, eyes, generator.uniform(0, 0.6), generator)
            colour[cap] = self._cloth(rest[cap], generator)
        light = generator.normal((0, -1.2, -0.6), 1)
        light /= np.linalg.norm(light)
        ambient = generator.uniform(0.35, 0.85)
        lit = ambient + (1.15 - ambient) * np.maximum(0, normals @ light.astype(np.float32))
        # Folds: waves along the surface that bend the light.
        waves = generator.normal(0, 25, (3, 4)).astype(np.float32)
        folds = np.sin(rest @ waves + generator.uniform(0, 6, 4).astype(np.float32)).sum(axis=1)
        lit *= 1 + generator.uniform(0, 0.08) * folds * ~body
        return np.asarray(colour * lit[:, None], np.float32)

    def _paint_clothes(
        self,
        colour: NDArray[np.float32],
        rest: NDArray[np.float32],
        up: NDArray[np.float32],
        body: NDArray[np.bool_],
        looks: tuple[NDArray[np.floating], NDArray[np.float32], bool],
        generator: np.random.Generator,
    ) -> NDArray[np.bool_]:
        """Paint tight clothes on a body without garments, long or short; say which are upper."""
        hair, eyes, man = looks
        out = np.abs(rest[:, 0])
        upper = body & (up > 0.53) & (up < 0.83) & (out < generator.uniform(0.2, 0.75))
        legs = body & (up <= 0.53) & (up > generator.uniform(0.05, 0.4)) & (out < 0.35)
        shod = body & (up < 0.05) & (generator.random() < 0.6)
        if generator.random() < BARE_SHARE:
            trunk = body & (up > 0.53) & (up < 0.86) & (out < 0.25)
            skin = colour[trunk]
            paint_bare_trunk(skin, rest[trunk], up[trunk], hair, man, generator)
            colour[trunk] = skin
            upper &= False
        for part in (upper, legs, shod):
            colour[part] = self._cloth(rest[part], generator)
        if generator.random() > BALD_SHARE:
            colour[body & scalp_of(rest, eyes, generator.uniform(0.4, 1.0), generator)] = hair
        return upper

    def _colour_garments(
        self,
        colour: NDArray[np.float32],
        which: int,
        triangles: NDArray[np.int32],
        rest: NDArray[np.float32],
        up: NDArray[np.float32],
        hair: NDArray[np.floating],
        generator: np.random.Generator,
    ) -> NDArray[np.bool_]:
        """Colour what is worn over the body and the hair; say which points are of the trunk."""
        avatar = self.avatars[which]
        worn = (triangles >= avatar.closed) & (triangles < len(avatar.triangles))
        piece = np.where(worn, self._pieces[which][np.where(worn, triangles, 0)], -1)
        shoes = self._cloth(rest[:1], generator)
        upper = np.zeros(len(rest), bool)
        tops = self._tops[which]
        for number in np.unique(piece[worn]):
            part = piece == number
            if tops[number] > 0.92:
                colour[part] = hair
            elif tops[number] < 0.13:
                colour[part] = shoes
            else:
                split = (up > 0.55) if generator.random() < 0.5 else np.ones_like(part)
                for some in (part & split, part & ~split):
                    colour[some] = self._cloth(rest[some], generator)
                upper |= part & (up > 0.55)
        return upper

    def _cloth(
        self, rest: NDArray[np.float32], generator: np.random.Generator
    ) -> NDArray[np.float32]:
        """Colours ``(P, 3)`` of a piece of cloth: plain, striped, checked or printed."""
        hsv = np.array([[[generator.integers(180), 0, 0]]], np.uint8)
        hsv[..., 1] = int(255 * generator.beta(1, 2.5))
        hsv[..., 2] = int(20 + 220 * generator.beta(1, 1.3))
        base = cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0, 0].astype(np.float32)
        kind = generator.random()
        if kind < 0.55 or len(rest) == 0:
            return np.tile(base, (len(rest), 1)).astype(np.float32)
        if kind < 0.75:
            second = base * generator.uniform(0.4, 0.9)
            axes = rest[:, :2] if generator.random() < 0.3 else rest[:, [1]]
            wave = np.sin(axes * generator.uniform(40, 250)).min(axis=1)
            return np.asarray(np.where((wave > 0)[:, None], base, second), np.float32)
        photograph = self.textures[int(generator.integers(len(self.textures)))]
        rows, columns = photograph.shape[:2]
        density = generator.uniform(150, 600)
        offset = generator.uniform(0, 1000, 2)
        x = (rest[:, 0] * density + rest[:, 2] * density + offset[0]).astype(int) % columns
        y = (-rest[:, 1] * density + offset[1]).astype(int) % rows
        printed = photograph[y, x].astype(np.float32)
        strength = generator.uniform(0.2, 1.0)
        middle = printed.mean(axis=0)
        return np.asarray(np.clip(base + strength * (printed - middle), 0, 255), np.float32)
