"""The potential of `_gong_energy` as a C function, compiled by Numba.

Sums over modes, points and shapes are done in one direction at a time, as there. Every function of x, and of y, is even
or odd about the middle, and half of the points is enough: a sum E of the even ones and a sum O of the odd ones give
E + O at a point and E - O at its mirror image; in sums over points, the sum of both halves meets the even functions and
their difference the odd ones. No sum is reordered by the compiler: the numbers do not depend on the processor.
"""

from __future__ import annotations

import numba as nb
import numpy as np

#: numbers at the head of the packed arrays
HEAD = 10


@nb.njit(cache=True)
def _add(a, b, out, rows, first, last, sign):
    """Add sign a[:, first:last] b[first:last] to the first `rows` of out, four rows of b at a time."""
    width = b.shape[1]
    for i in range(rows):
        k = first
        while k + 4 <= last:
            a0, a1, a2, a3 = sign * a[i, k], sign * a[i, k + 1], sign * a[i, k + 2], sign * a[i, k + 3]
            for j in range(width):
                out[i, j] += a0 * b[k, j] + a1 * b[k + 1, j] + a2 * b[k + 2, j] + a3 * b[k + 3, j]
            k += 4
        while k < last:
            a0 = sign * a[i, k]
            for j in range(width):
                out[i, j] += a0 * b[k, j]
            k += 1


@nb.njit(cache=True)
def _to_points_x(s, c, out, sign, work):
    """Out (2 h, r) from functions s (h, m) and c (m, r); the first group is even where sign is 1."""
    h, m, r = s.shape[0], s.shape[1], c.shape[1]
    odd = work[: h * r].reshape(h, r)
    even = out[:h]
    even[:] = 0.0
    odd[:] = 0.0
    _add(s, c, even, h, 0, (m + 1) // 2, 1.0)
    _add(s, c, odd, h, (m + 1) // 2, m, 1.0)
    for i in range(h):
        for j in range(r):
            a, b = even[i, j], odd[i, j]
            out[i, j] = a + b
            out[h + i, j] = sign * (a - b)


@nb.njit(cache=True)
def _to_points_y(c, s, out, sign, work):
    """Out (r, 2 h) from c (r, m) and functions s (m, h)."""
    r, m, h = c.shape[0], s.shape[0], s.shape[1]
    even = work[: r * h].reshape(r, h)
    odd = work[r * h : 2 * r * h].reshape(r, h)
    even[:] = 0.0
    odd[:] = 0.0
    _add(c, s, even, r, 0, (m + 1) // 2, 1.0)
    _add(c, s, odd, r, (m + 1) // 2, m, 1.0)
    for i in range(r):
        for j in range(h):
            out[i, j] = even[i, j] + odd[i, j]
            out[i, h + j] = sign * (even[i, j] - odd[i, j])


@nb.njit(cache=True)
def _from_points_x(s, g, out, sign, work):
    """Add s (m, h) g (2 h, r) to out (m, r), s with its mirror images."""
    m, h, r = s.shape[0], s.shape[1], g.shape[1]
    both = work[: h * r].reshape(h, r)
    half = (m + 1) // 2
    for i in range(h):
        for j in range(r):
            both[i, j] = g[i, j] + sign * g[h + i, j]
    _add(s[:half], both, out[:half], half, 0, h, 1.0)
    for i in range(h):
        for j in range(r):
            both[i, j] = g[i, j] - sign * g[h + i, j]
    _add(s[half:], both, out[half:], m - half, 0, h, 1.0)


@nb.njit(cache=True)
def _from_points_y(g, s, out, sign, factor, work):
    """Add factor g (r, 2 h) s (h, m) to out (r, m)."""
    r, h, m = g.shape[0], s.shape[0], s.shape[1]
    both = work[: r * h].reshape(r, h)
    half = (m + 1) // 2
    for i in range(r):
        for j in range(h):
            both[i, j] = g[i, j] + sign * g[i, h + j]
    _add(both, s[:, :half], out[:, :half], r, 0, h, factor)
    for i in range(r):
        for j in range(h):
            both[i, j] = g[i, j] - sign * g[i, h + j]
    _add(both, s[:, half:], out[:, half:], r, 0, h, factor)


@nb.njit(cache=True)
def _airy(compliance, blocks, b, f, work):
    """Coefficients of the stress function from b (jx, jy): elementwise, or by four blocks of equal parities."""
    jx, jy = b.shape
    if blocks == 0:
        for i in range(jx):
            for j in range(jy):
                f[i, j] = compliance[i * jy + j] * b[i, j]
        return
    hx, hy = (jx + 1) // 2, (jy + 1) // 2
    for q in range(4):
        x0, x1 = (0, hx) if q < 2 else (hx, jx)
        y0, y1 = (0, hy) if q % 2 == 0 else (hy, jy)
        wide, count = y1 - y0, (x1 - x0) * (y1 - y0)
        # the block is symmetric: its rows are its columns
        block = compliance[q * blocks * blocks : (q + 1) * blocks * blocks].reshape(blocks, blocks)[:count, :count]
        source, solution = work[:count].reshape(1, count), work[count : 2 * count].reshape(1, count)
        for i in range(count):
            source[0, i] = b[x0 + i // wide, y0 + i % wide]
            solution[0, i] = 0.0
        _add(source, block, solution, 1, 0, count, 1.0)
        for i in range(count):
            f[x0 + i // wide, y0 + i % wide] = solution[0, i]


@nb.njit(cache=True)
def _take(data, start, rows, columns):
    """Matrix that begins at `start`, and the place behind it."""
    end = start + rows * columns
    return data[start:end].reshape(rows, columns), end


def potential(data_at, n, y_at, gradient_at, scratch_at):
    """V, J, of n coordinates at `y_at`; writes dV/dy unless `gradient_at` is NULL. `data_at`: `PlateGrid.packed`."""
    head = nb.carray(data_at, HEAD, np.float64)
    mx, my, hx, hy = int(head[0]), int(head[1]), int(head[2]), int(head[3])
    jx, jy, blocks, modulus, poisson, stiffness = int(head[4]), int(head[5]), int(head[6]), head[7], head[8], head[9]
    stress = jx * jy if blocks == 0 else 4 * blocks * blocks
    total = HEAD + 6 * hx * mx + 6 * hy * my + 2 * hx * jx + 2 * hy * jy + stress + 3 * n
    data, y = nb.carray(data_at, total, np.float64), nb.carray(y_at, n)
    sx, at = _take(data, HEAD, hx, mx)
    sxx, at = _take(data, at, hx, mx)
    cx, at = _take(data, at, hx, mx)
    sxt, at = _take(data, at, mx, hx)
    sxxt, at = _take(data, at, mx, hx)
    cxt, at = _take(data, at, mx, hx)
    sy, at = _take(data, at, my, hy)
    syy, at = _take(data, at, my, hy)
    cy, at = _take(data, at, my, hy)
    syt, at = _take(data, at, hy, my)
    syyt, at = _take(data, at, hy, my)
    cyt, at = _take(data, at, hy, my)
    px, at = _take(data, at, jx, hx)
    pxt, at = _take(data, at, hx, jx)
    py, at = _take(data, at, jy, hy)
    pyt, at = _take(data, at, hy, jy)
    compliance = data[at : at + stress]
    places, ax, ay = data[at + stress :][:n], data[at + stress + n :][:n], data[at + stress + 2 * n :][:n]

    kept = 2 * mx * my + 2 * mx * hy + 16 * hx * hy + 2 * jx * hy + 2 * jx * jy
    scratch = nb.carray(scratch_at, kept + 4 * max(hx, jx, mx) * max(hy, jy, my))
    c, o = _take(scratch, 0, mx, my)
    slope, o = _take(scratch, o, mx, my)
    across, o = _take(scratch, o, mx, 2 * hy)
    wxx, o = _take(scratch, o, 2 * hx, 2 * hy)
    wyy, o = _take(scratch, o, 2 * hx, 2 * hy)
    wxy, o = _take(scratch, o, 2 * hx, 2 * hy)
    force, o = _take(scratch, o, 2 * hx, 2 * hy)
    between, o = _take(scratch, o, jx, 2 * hy)
    b, o = _take(scratch, o, jx, jy)
    f, o = _take(scratch, o, jx, jy)
    work = scratch[o:]

    flat = c.reshape(mx * my)
    flat[:] = 0.0
    ex = ey = 0.0
    for k in range(n):
        flat[int(places[k])] = y[k]
        ex += 0.5 * ax[k] * y[k] * y[k]
        ey += 0.5 * ay[k] * y[k] * y[k]
    _to_points_y(c, sy, across, 1.0, work)
    _to_points_x(sxx, across, wxx, 1.0, work)
    _to_points_y(c, syy, across, 1.0, work)
    _to_points_x(sx, across, wyy, 1.0, work)
    _to_points_y(c, cy, across, -1.0, work)
    _to_points_x(cx, across, wxy, -1.0, work)
    for i in range(2 * hx):
        for j in range(2 * hy):
            force[i, j] = 2 * (wxx[i, j] * wyy[i, j] - wxy[i, j] * wxy[i, j])
    between[:] = 0.0
    b[:] = 0.0
    _from_points_x(px, force, between, 1.0, work)
    _from_points_y(between, pyt, b, 1.0, 1.0, work)
    _airy(compliance, blocks, b, f, work)
    value = 0.5 * stiffness * (ex * ex + ey * ey + 2 * poisson * ex * ey)
    for i in range(jx):
        for j in range(jy):
            value += modulus / 8 * b[i, j] * f[i, j]
    gradient = nb.carray(gradient_at, n)
    if gradient.ctypes.data == 0:
        return value

    for i in range(jx):
        for j in range(jy):
            f[i, j] *= modulus / 2
    _to_points_y(f, py, between, 1.0, work)
    _to_points_x(pxt, between, force, 1.0, work)
    for i in range(2 * hx):
        for j in range(2 * hy):
            xx, on = wxx[i, j], force[i, j]
            wxx[i, j] = on * wyy[i, j]
            wyy[i, j] = on * xx
            wxy[i, j] = on * wxy[i, j]
    slope[:] = 0.0
    across[:] = 0.0
    _from_points_x(sxxt, wxx, across, 1.0, work)
    _from_points_y(across, syt, slope, 1.0, 1.0, work)
    across[:] = 0.0
    _from_points_x(sxt, wyy, across, 1.0, work)
    _from_points_y(across, syyt, slope, 1.0, 1.0, work)
    across[:] = 0.0
    _from_points_x(cxt, wxy, across, -1.0, work)
    _from_points_y(across, cyt, slope, -1.0, -2.0, work)
    flat_slope = slope.reshape(mx * my)
    tension_x, tension_y = stiffness * (ex + poisson * ey), stiffness * (ey + poisson * ex)
    for k in range(n):
        gradient[k] = flat_slope[int(places[k])] + (tension_x * ax[k] + tension_y * ay[k]) * y[k]
    return value


_NUMBERS = nb.types.CPointer(nb.types.float64)
_SIGNATURE = nb.types.float64(nb.types.voidptr, nb.types.int64, _NUMBERS, _NUMBERS, _NUMBERS)
#: `potential` as a C function
compiled = nb.cfunc(_SIGNATURE, cache=True)(potential)
