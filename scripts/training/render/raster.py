"""The renderer: triangles with a depth buffer, rooms by rays, patterns, light and shadows."""

import math
from typing import TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

NOTHING = -1
"""Triangle of a pixel that shows the room."""

Floats: TypeAlias = NDArray[np.float32]
Ints: TypeAlias = NDArray[np.int32]
Vector: TypeAlias = tuple[float, float, float]


@njit(nogil=True, cache=True)
def vertex_normals(vertices: Floats, triangles: Ints) -> Floats:
    """Unit normals ``(V, 3)``: the mean of the triangles about each vertex, by their area."""
    normals = np.zeros_like(vertices)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, vx = vertices[b, 0] - vertices[a, 0], vertices[c, 0] - vertices[a, 0]
        uy, vy = vertices[b, 1] - vertices[a, 1], vertices[c, 1] - vertices[a, 1]
        uz, vz = vertices[b, 2] - vertices[a, 2], vertices[c, 2] - vertices[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for k in (a, b, c):
            normals[k, 0] += x
            normals[k, 1] += y
            normals[k, 2] += z
    for k in range(len(normals)):
        x, y, z = normals[k, 0], normals[k, 1], normals[k, 2]
        length = np.sqrt(x * x + y * y + z * z) + np.float32(1e-12)
        normals[k, 0], normals[k, 1], normals[k, 2] = x / length, y / length, z / length
    return normals


@njit(nogil=True, cache=True)
def rasterise(
    plane: Floats,
    depths: Floats,
    triangles: Ints,
    min_depth: float,
    nearness: Floats,
    shown: Ints,
    shares: Floats,
) -> None:
    """Find which triangle ``(T, 3)`` each pixel shows.

    ``plane`` ``(V, 2)`` are projected vertices, pixels, and ``depths`` ``(V,)`` metres along the
    optical axis; triangles that reach nearer than ``min_depth`` are left out. Where a triangle is
    nearer, one over its depth is written to ``nearness`` ``(H, W)``, its number to ``shown`` ``(H,
    W)``, and the weights of its first two corners, in perspective, to ``shares`` ``(H, W, 2)``.
    """
    height, width = nearness.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if depths[a] < min_depth or depths[b] < min_depth or depths[c] < min_depth:
            continue
        ax, ay, bx, by = plane[a, 0], plane[a, 1], plane[b, 0], plane[b, 1]
        cx, cy = plane[c, 0], plane[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:
            continue
        left = max(int(np.ceil(min(ax, min(bx, cx)))), 0)
        right = min(int(np.floor(max(ax, max(bx, cx)))), width - 1)
        top = max(int(np.ceil(min(ay, min(by, cy)))), 0)
        bottom = min(int(np.floor(max(ay, max(by, cy)))), height - 1)
        if left > right or top > bottom:
            continue
        na, nb, nc = 1 / depths[a], 1 / depths[b], 1 / depths[c]
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                first = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                second = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                third = 1 - first - second
                if first < 0 or second < 0 or third < 0:
                    continue
                near = first * na + second * nb + third * nc
                if near > nearness[y, x]:
                    nearness[y, x] = near
                    shown[y, x] = t
                    shares[y, x, 0] = first * na / near
                    shares[y, x, 1] = second * nb / near


@njit(nogil=True, cache=True)
def shadow_map(points: Floats, triangles: Ints, heights: Floats) -> None:
    """Raise a map ``(S, S)`` to the triangles nearest to the light.

    ``points`` ``(V, 3)``: column and row of the map, and metres towards the light.
    """
    size = len(heights)
    for t in range(len(triangles)):
        ax, ay, az = points[triangles[t, 0]]
        bx, by, bz = points[triangles[t, 1]]
        cx, cy, cz = points[triangles[t, 2]]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:
            continue
        left = max(int(np.ceil(min(ax, min(bx, cx)))), 0)
        right = min(int(np.floor(max(ax, max(bx, cx)))), size - 1)
        top = max(int(np.ceil(min(ay, min(by, cy)))), 0)
        bottom = min(int(np.floor(max(ay, max(by, cy)))), size - 1)
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                first = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                second = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                third = 1 - first - second
                if first >= 0 and second >= 0 and third >= 0:
                    height = first * az + second * bz + third * cz
                    if height > heights[y, x]:
                        heights[y, x] = height


@njit(nogil=True, cache=True)
def _hash(x: float, y: float, z: float) -> float:
    """A number from 0 to 1 for each cell of space."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    mixed = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791)
    mixed = ((mixed ^ (mixed >> 13)) * 1274126177) & 0xFFFFFFFF
    return ((mixed ^ (mixed >> 15)) & 0xFFFF) / 65535.0


@njit(nogil=True, cache=True)
def _smooth(x: float, y: float, z: float) -> float:
    """Value noise from 0 to 1."""
    fx, fy, fz = x - np.floor(x), y - np.floor(y), z - np.floor(z)
    fx, fy, fz = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy), fz * fz * (3 - 2 * fz)
    total = 0.0
    for i in range(2):
        for j in range(2):
            for k in range(2):
                weight = (fx if i else 1 - fx) * (fy if j else 1 - fy) * (fz if k else 1 - fz)
                total += weight * _hash(x + i, y + j, z + k)
    return total


@njit(nogil=True, cache=True)
def _pattern(kind: int, f: float, phase: float, duty: float, x: float, y: float, z: float) -> float:
    """Share of the other colour at a place of a material."""
    if kind == 1:
        return 1.0 if (y * f + phase) % 1.0 < duty else 0.0
    if kind == 2:
        return 1.0 if ((x + 0.4 * z) * f + phase) % 1.0 < duty else 0.0
    if kind == 3:
        one = 0.5 if (y * f) % 1.0 < 0.5 else 0.0
        return one + (0.5 if (x * f + 0.2 + z * f * 0.5) % 1.0 < 0.5 else 0.0)
    if kind == 4:
        return 1.0 if _smooth(x * f + phase, y * f, z * f) > 0.35 + 0.4 * duty else 0.0
    if kind == 5:
        inside = abs(x) < 0.09 and abs(y - 0.25 - 0.2 * phase) < 0.1 and z > 0
        return _hash(x * 40, y * 40, phase * 9) if inside else 0.0
    if kind == 6:
        return 0.5 + 0.5 * math.sin(y * f * 30) * math.sin(x * f * 33 + y * 4 + z * 29)
    if kind == 7:
        return _hash(x * f * 3 + phase, y * f, z * f * 3)
    if kind == 8:
        gap = (x * f + phase) % 1.0 < duty
        return 1.0 if gap else 0.6 * _hash(x * f + phase, 0.0, 0.0) + 0.2 * _smooth(x * 9, y, z)
    if kind == 9:
        edge = (x * f + phase) % 1.0 < duty or (y * f) % 1.0 < duty or (z * f + phase) % 1.0 < duty
        return 1.0 if edge else 0.0
    if kind == 10:
        coarse = _smooth(x * f + phase, y * f, z * f)
        return 0.6 * coarse + 0.4 * _smooth(x * f * 5, y * f * 5, z * f * 5 + phase)
    return 0.0


@njit(nogil=True, cache=True)
def _lit(
    wx: float,
    wy: float,
    wz: float,
    x: int,
    y: int,
    to_light: Floats,
    heights: Floats,
    softness: float,
    bias: float,
) -> float:
    """Share of the light that reaches a place: four probes of the shadow map."""
    u = to_light[0, 0] * wx + to_light[0, 1] * wy + to_light[0, 2] * wz + to_light[0, 3]
    v = to_light[1, 0] * wx + to_light[1, 1] * wy + to_light[1, 2] * wz + to_light[1, 3]
    h = to_light[2, 0] * wx + to_light[2, 1] * wy + to_light[2, 2] * wz + to_light[2, 3]
    # Four probes on a square, which is turned and sized from pixel to pixel.
    one = softness * (2 * _hash(x, y, 0.0) - 1)
    two = softness * (2 * _hash(x, y, 1.0) - 1)
    lit = 0.0
    for _ in range(4):
        i, j = int(u + one + 0.5), int(v + two + 0.5)
        one, two = -two, one
        if i < 0 or j < 0 or i >= len(heights) or j >= len(heights) or heights[j, i] < h + bias:
            lit += 0.25
    return lit


@njit(nogil=True, cache=True)
def _direct_light(
    normal: Vector,
    place: Vector,
    x: int,
    y: int,
    light: Floats,
    to_light: Floats,
    heights: Floats,
    bias: float,
) -> float:
    """Share of the first light that a surface sends back, with shadows."""
    facing = normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2]
    if facing <= 0:
        return 0.0
    wx, wy, wz = place
    return float(facing * _lit(wx, wy, wz, x, y, to_light, heights, light[13], bias))


@njit(nogil=True, cache=True)
def _second_light(normal: Vector, light: Floats) -> float:
    """Share of the second light that a surface sends back; it casts no shadows."""
    facing = normal[0] * light[3] + normal[1] * light[4] + normal[2] * light[5]
    return float(max(0.0, facing) * light[12])


@njit(nogil=True, cache=True)
def _gleam(normal: Vector, view: Vector, light: Floats) -> float:
    """Blinn-Phong highlight of the first light."""
    hx, hy, hz = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    half = np.sqrt(hx * hx + hy * hy + hz * hz) + 1e-9
    return float(max(0.0, (normal[0] * hx + normal[1] * hy + normal[2] * hz) / half) ** 24)


@njit(nogil=True, cache=True)
def _unit(x: float, y: float, z: float) -> Vector:
    length = np.sqrt(x * x + y * y + z * z) + 1e-9
    return x / length, y / length, z / length


@njit(nogil=True, cache=True)
def _interpolated(values: Floats, corners: Ints, weights: Vector) -> Vector:
    """Value at a place of a triangle, from those at its corners."""
    a, b, c = corners[0], corners[1], corners[2]
    first, second, third = weights
    return (
        first * values[a, 0] + second * values[b, 0] + third * values[c, 0],
        first * values[a, 1] + second * values[b, 1] + third * values[c, 1],
        first * values[a, 2] + second * values[b, 2] + third * values[c, 2],
    )


@njit(nogil=True, cache=True)
def _nearest_corner(weights: Vector) -> int:
    first, second, third = weights
    if second > first and second >= third:
        return 1
    return 2 if third > first and third > second else 0


@njit(nogil=True, cache=True)
def _wrinkled(normal: Vector, texture: Vector, depth: float, wrinkles: Floats) -> Vector:
    """Turn a normal by the waves of cloth; the result has any length."""
    nx, ny, nz = normal
    for k in range(len(wrinkles)):
        w = wrinkles[k]
        phase = w[0] * texture[0] + w[1] * texture[1] + w[2] * texture[2] + w[3]
        wave = depth * w[4] * np.sin(phase)
        nx += wave * w[5]
        ny += wave * w[6]
        nz += wave * w[7]
    return nx, ny, nz


@njit(nogil=True, cache=True)
def shade(
    nearness: Floats,
    shown: Ints,
    shares: Floats,
    triangles: Ints,
    vertices: Floats,
    normals: Floats,
    textured: Floats,
    material_of: Ints,
    materials: Floats,
    wrinkles: Floats,
    camera: Floats,
    light: Floats,
    to_light: Floats,
    heights: Floats,
    picture: Floats,
) -> None:
    """Colour the pixels that show triangles.

    Parameters
    ----------
    nearness, shown, shares
        As :func:`rasterise` leaves them.
    triangles : (T, 3) int32 array
    vertices, normals, textured : (V, 3) float32 array
        World axes; places in the pattern.
    material_of : (V,) int32 array
    materials : (M, 12) float32 array
        See :meth:`scripts.training.render.materials.Materials.table`.
    wrinkles : (K, 8) float32 array
        Waves: wave vector, phase, amplitude, direction in which they turn the normal.
    camera : (3,) float32 array
        Place, world axes.
    light : (14,) float32 array
        Direction to the light, direction to the second, colour of the sky, colour of the light,
        strength of the second, softness of shadows in pixels of their map.
    to_light : (3, 4) float32 array
        World axes to column and row of the shadow map and height towards the light.
    heights : (S, S) float32 array
        Shadow map.
    picture : (H, W, 3) float32 array
        Written: linear RGB.
    """
    height, width = nearness.shape
    for y in range(height):
        for x in range(width):
            t = shown[y, x]
            if t < 0:
                continue
            first, second = shares[y, x, 0], shares[y, x, 1]
            weights = (first, second, 1 - first - second)
            corners = triangles[t]
            m = materials[material_of[corners[_nearest_corner(weights)]]]
            nx, ny, nz = _interpolated(normals, corners, weights)
            texture = _interpolated(textured, corners, weights)
            wx, wy, wz = _interpolated(vertices, corners, weights)
            view = _unit(camera[0] - wx, camera[1] - wy, camera[2] - wz)
            if nx * view[0] + ny * view[1] + nz * view[2] < 0:
                nx, ny, nz = -nx, -ny, -nz
            if m[10] > 0:
                nx, ny, nz = _wrinkled((nx, ny, nz), texture, m[10], wrinkles)
            nx, ny, nz = normal = _unit(nx, ny, nz)
            share = _pattern(int(m[6]), m[7], m[8], m[9], texture[0], texture[1], texture[2])
            # Probed a little above the surface, which would else shade itself.
            above = (wx + 0.02 * nx, wy + 0.02 * ny, wz + 0.02 * nz)
            direct = _direct_light(normal, above, x, y, light, to_light, heights, 0.02)
            other = _second_light(normal, light)
            sky = 0.72 + 0.28 * ny
            gleam = _gleam(normal, view, light) * m[11] * direct
            for k in range(3):
                base = m[k] * (1 - share) + m[3 + k] * share
                lit = light[6 + k] * sky + light[9 + k] * direct + other
                picture[y, x, k] = base * lit + gleam * light[9 + k] * 3


@njit(nogil=True, cache=True)
def _surface_of(camera: Floats, ray: Vector, room: Floats) -> tuple[int, float]:
    """The surface of a room that a ray meets, and how many lengths of the ray away it is."""
    reach, side = 1e9, 0
    for axis in range(3):
        step = ray[axis]
        if abs(step) < 1e-7:
            continue
        end = 1 if step > 0 else 0
        along = (room[end, axis] - camera[axis]) / step
        if along < reach:
            reach, side = along, 2 * axis + end
    return side, reach


@njit(nogil=True, cache=True)
def _panel_at(panels: Floats, side: int, u: float, v: float) -> int:
    """The last panel that covers a place of a surface, or -1."""
    for k in range(len(panels) - 1, -1, -1):
        inside = panels[k, 1] <= u <= panels[k, 2] and panels[k, 3] <= v <= panels[k, 4]
        if inside and int(panels[k, 0]) == side:
            return k
    return -1


@njit(nogil=True, cache=True)
def _inward_normal(side: int) -> Vector:
    nx = 1.0 if side == 0 else -1.0 if side == 1 else 0.0
    ny = 1.0 if side == 2 else -1.0 if side == 3 else 0.0
    nz = 1.0 if side == 4 else -1.0 if side == 5 else 0.0
    return nx, ny, nz


@njit(nogil=True, cache=True)
def _lamp_falloff(place: Vector, glow: Floats) -> float:
    """Factor by which light falls off with the distance from a lamp."""
    near = (place[0] - glow[0]) ** 2 + (place[1] - glow[1]) ** 2 + (place[2] - glow[2]) ** 2
    return float(1 - glow[3] + glow[3] / (1 + near / (glow[4] * glow[4])))


@njit(nogil=True, cache=True)
def paint_room(
    to_world: Floats,
    camera: Floats,
    pinhole: Floats,
    room: Floats,
    materials: Floats,
    panels: Floats,
    light: Floats,
    glow: Floats,
    to_light: Floats,
    heights: Floats,
    nearness: Floats,
    picture: Floats,
) -> None:
    """Paint walls, floor and ceiling of a room seen from inside.

    Parameters
    ----------
    to_world : (3, 3) float32 array
        Camera axes to those of the room.
    camera : (3,) float32 array
        Place, axes of the room.
    pinhole : (4,) float32 array
        Focal lengths and principal point, pixels.
    room : (2, 3) float32 array
        Lowest and highest corner, axes of the room.
    materials : (6, 12) float32 array
        Of the surfaces low x, high x, floor, ceiling, low z, high z.
    panels : (P, 18) float32 array
        Rectangles on surfaces: surface, low and high along the first and second axis, brightness,
        then a material.
    light : (14,) float32 array
        As of :func:`shade`, in axes of the room.
    glow : (5,) float32 array
        Place of a lamp, its share, its reach in metres.
    to_light, heights
        Shadow map, from axes of the room.
    nearness : (H, W) float32 array
        Written.
    picture : (H, W, 3) float32 array
        Written: linear RGB.
    """
    height, width = nearness.shape
    for y in range(height):
        for x in range(width):
            px, py = (x - pinhole[2]) / pinhole[0], (y - pinhole[3]) / pinhole[1]
            ray = (
                to_world[0, 0] * px + to_world[0, 1] * py + to_world[0, 2],
                to_world[1, 0] * px + to_world[1, 1] * py + to_world[1, 2],
                to_world[2, 0] * px + to_world[2, 1] * py + to_world[2, 2],
            )
            side, reach = _surface_of(camera, ray, room)
            nearness[y, x] = 1 / reach
            wx = camera[0] + reach * ray[0]
            wy = camera[1] + reach * ray[1]
            wz = camera[2] + reach * ray[2]
            u = wz if side < 2 else wx
            v = wz if 2 <= side < 4 else wy
            m, bright = materials[side], 0.0
            panel = _panel_at(panels, side, u, v)
            if panel >= 0:
                m, bright = panels[panel, 6:], panels[panel, 5]
            share = _pattern(int(m[6]), m[7], m[8], m[9], u, v, 0.37)
            place, normal = (wx, wy, wz), _inward_normal(side)
            direct = _direct_light(normal, place, x, y, light, to_light, heights, 0.03)
            falls = _lamp_falloff(place, glow)
            other = _second_light(normal, light)
            sky = (0.72 + 0.28 * normal[1]) * falls
            for k in range(3):
                base = m[k] * (1 - share) + m[3 + k] * share
                lit = light[6 + k] * sky + light[9 + k] * direct * falls + other
                picture[y, x, k] = base * (lit + bright)
