"""Thin lenses of cells that differ, lens by lens in 90 digits; shares no code with clacad.

One axis: lens 1 of cell X is at X, lens 2 at X + f1 (δ₀ + κX), a distance s behind it, f1 + f2 = s, f2 = −ηf1.
"""

from __future__ import annotations

from mpmath import mp, mpf

DIGITS = 90  # fifty are left where forty cancel


def crossing(first, second):
    """Distance behind a plane and height where two rays (height, slope) meet."""
    along = -(first[0] - second[0]) / (first[1] - second[1])
    return along, first[0] + along * first[1]


def focal_lengths(eta, separation):
    f1 = mpf(separation) / (1 - mpf(eta))
    return f1, -mpf(eta) * f1


def through(lenses, pose, ray):
    """A ray (height, slope) before lens 1 through lenses (f1, f2) at heights `pose`, `gap` apart: at lens 2, behind it."""
    (f1, f2), (at_1, at_2, gap) = lenses, pose
    height, slope = ray
    slope -= (height - at_1) / f1
    height += gap * slope
    return height, slope - (height - at_2) / f2


def behind(glens, point, cell, off):
    """The ray from a point (x, z) that meets lens 1 of cell X `off` its centre, behind array 2: height, slope."""
    eta, kappa, separation, delta = (mpf(v) for v in glens)
    f1, f2 = focal_lengths(eta, separation)
    x, z = (mpf(v) for v in point)
    cell, off = mpf(cell), mpf(off)
    pose = cell, cell + f1 * (delta + kappa * cell), separation
    return through((f1, f2), pose, (cell + off, (cell + off - x) / -z))


def image(glens, point):
    """Where the chief rays of two cells meet: behind array 2, and across."""
    with mp.workdps(DIGITS):
        return crossing(behind(glens, point, 0, 0), behind(glens, point, 1, 0))


def width(glens, point, pitch):
    """Width of the light of the cell at 0 where the chief rays meet, lens 1 filled."""
    with mp.workdps(DIGITS):
        along, _ = image(glens, point)
        high, low = (behind(glens, point, 0, side * mpf(pitch) / 2) for side in (1, -1))
        return abs(high[0] - low[0] + along * (high[1] - low[1]))


def sharp_crossings(focal, pitches, gap, point, cells, offs):
    """Where rays from a point through lenses of pitches p1 and p2 meet that of the first, behind array 2 and across."""
    with mp.workdps(DIGITS):
        f1, f2 = (mpf(v) for v in focal)
        p1, p2 = (mpf(v) for v in pitches)
        x, z = (mpf(v) for v in point)
        rays = []
        for cell in cells:
            for off in offs:
                height = cell * p1 + mpf(off)
                rays.append(through((f1, f2), (cell * p1, cell * p2, mpf(gap)), (height, (height - x) / -z)))
        return [crossing(rays[0], ray) for ray in rays[1:]]


def sharp(focal, z, far):
    """Separation and pitch ratio of lenses f1, f2 that image the height z sharply to `far` behind array 2."""
    with mp.workdps(DIGITS):
        (f1, f2), z, far = (mpf(v) for v in focal), mpf(z), mpf(far)
        between, beyond = 1 / (1 / f1 + 1 / z), 1 / (1 / f2 - 1 / far)
        return between + beyond, (1 - between / z) * far / (beyond + far)


def law_slopes(eta, delta, gradient, place, slopes):
    """Slopes behind an upright sheet of offset δ₀ + K r at a place r."""
    with mp.workdps(DIGITS):
        made = []
        for k in range(2):
            offset = mpf(delta[k]) + sum(mpf(gradient[k][i]) * mpf(place[i]) for i in range(2))
            made.append((mpf(slopes[k]) - offset) / mpf(eta[k]))
        return made
