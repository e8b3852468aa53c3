"""Fit a Law to directions before and behind a sheet; `verify` reports the result as measured η and δ."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.types import Floats
from clacad.base.vectors import axes_across, lengths, unit
from clacad.optics.law.orientation import (
    LawParameters,
    angle_between,
    candidate_axes,
    decompose,
    is_direction,
    power_of_two_scaled,
)

NAMES = ("eta_x", "eta_y", "delta_x", "delta_y", "phi", "theta", "psi")
NO_POWER = "the exit directions do not depend on the incoming ones along an axis: eta is infinite"
_STARTS = 6  # number of local minima that are searched
_START_RAYS = 1024  # enough rays to find the best local minimum; all rays refine it
_LEAST_DAMPING = 1e-14  # of the largest singular value squared
_KNOWN = 1e-10  # least relative singular value that counts: below it 1e-16 of light is 1e-6 of a parameter


class FittedParameters(NamedTuple):
    """Parameters of a law fitted to directions, and how well the directions determine them.

    See `clacad.Fit`.
    """

    law: LawParameters
    rms: float
    covariance: Floats
    rank: int
    free: tuple[str, ...]
    field: float
    rays: int


def fit_law(d_in: ArrayLike, d_out: ArrayLike, axes: LawParameters | None = None) -> FittedParameters:
    """Fit d_out ∝ A d_in.

    d_in, d_out : (n, 3) arrays, any length > 0
        Directions before and behind the sheet; rows that are not finite are left out.
    axes : Hold φ, θ, ψ at these values and fit η and δ (4 parameters, well conditioned); None fits all seven.
        In a narrow bundle θ and δ have similar effects; the covariance shows that.
    Raises ValueError: Fewer than 2 (axes held) or 4 usable rays, shapes that differ, or exit directions that
        do not depend on the incoming ones along an axis (η would be infinite).

    Notes
    -----
    A linear start (free axes: direct linear transform, Hartley & Zisserman, Multiple View Geometry, ch. 4),
    then Gauss–Newton in 1/η, δ/η and a small rotation of the lens frame, which stay regular where Euler
    angles do not.
    """
    a, b = usable_rays(d_in, d_out, 4 if axes is None else 2)
    found, free = (_free_fit(a, b), NAMES) if axes is None else (held_fit(a, b, axes), NAMES[:4])
    covariance, rank = _covariance(found, a, b, len(free))
    return FittedParameters(
        law=found,
        rms=float(np.sqrt(np.mean(angle_between(_exit(found, a), b) ** 2))),
        covariance=covariance,
        rank=rank,
        free=free,
        field=float(angle_between(a, a.mean(axis=0)).max()),
        rays=len(a),
    )


def usable_rays(d_in: ArrayLike, d_out: ArrayLike, least: int) -> tuple[Floats, Floats]:
    """Unit rows that are finite on both sides."""
    a, b = np.asarray(d_in, np.float64), np.asarray(d_out, np.float64)
    if a.ndim != 2 or a.shape[1] != 3 or a.shape != b.shape:
        raise ValueError(f"d_in has shape {a.shape} and d_out {b.shape}; both must be (n, 3)")
    keep = is_direction(a) & is_direction(b)
    if keep.sum() < least:
        raise ValueError(f"{keep.sum()} usable rays; at least {least} are needed for this fit")
    a, b = power_of_two_scaled(a[keep]), power_of_two_scaled(b[keep])
    return a / np.linalg.norm(a, axis=1, keepdims=True), b / np.linalg.norm(b, axis=1, keepdims=True)


# ------------------------------------------------------------------------------ starting points


def held_fit(a: Floats, b: Floats, axes: LawParameters) -> LawParameters:
    """η and δ for a fixed orientation: linear in 1/η and δ/η, then refined in angle."""
    r = axes.rotation
    m, w = a @ r, b @ r
    power, offset = np.empty(2), np.empty(2)
    for i in range(2):  # b_z (α m_i − β m_z) = b_i m_z, no slope formed
        columns = np.stack([w[:, 2] * m[:, i], -w[:, 2] * m[:, 2]], axis=1)
        power[i], offset[i] = np.linalg.lstsq(columns, w[:, i] * m[:, 2], rcond=1e-13)[0]
    power, offset, _ = _gauss_newton(power, offset, np.eye(3), m, w, turn=False)
    if not np.all(power != 0.0):
        raise ValueError(NO_POWER)
    (eta_x, eta_y), (delta_x, delta_y) = (1.0 / power).tolist(), (offset * (1.0 / power)).tolist()
    return LawParameters(eta_x, eta_y, delta_x, delta_y, axes.phi, axes.theta, axes.psi, axes.axes)


def _free_fit(a: Floats, b: Floats) -> LawParameters:
    """All seven parameters: the best of several starts, refined on all rays."""
    some = slice(None, None, max(1, len(a) // _START_RAYS))
    best, least = None, np.inf
    for start in _starts(a[some], b[some]):
        state = _gauss_newton(*_state(start), a[some], b[some], turn=True)
        cost = _cost(state, a[some], b[some])
        if cost < least:
            best, least = state, cost
    if best is None:
        raise ValueError(
            "no Law explains these directions even roughly: the best homography turns light back"
        )
    power, offset, r = _gauss_newton(*best, a, b, turn=True)
    matrix = r @ np.array([[power[0], 0, -offset[0]], [0, power[1], -offset[1]], [0, 0, 1]]) @ r.T
    found = decompose(matrix, r[:, 2])
    if found is None:
        raise ValueError(NO_POWER)
    return found.law


def _starts(a: Floats, b: Floats) -> list[LawParameters]:
    """Laws read from the best-fitting homography: the most promising of several assumed optical axes."""
    matrix = _homography(a, b)
    axes = [np.array([0.0, 0.0, 1.0]), *candidate_axes(matrix)]
    laws = [found.law for n in axes if (found := decompose(matrix, n)) is not None]
    return sorted(laws, key=lambda law: _cost(_state(law), a, b))[:_STARTS]


def _homography(a: Floats, b: Floats) -> Floats:
    """Direct linear transform b × (A a) = 0 on rows rotated and scaled to unit spread."""
    to_a, to_b = _normaliser(a), _normaliser(b)
    p, q = a @ to_a.T, b @ to_b.T
    rows = []
    for i, j in ((1, 2), (2, 0), (0, 1)):  # (q × Hp)_k = q_i (Hp)_j − q_j (Hp)_i
        row = np.zeros((len(p), 3, 3))
        row[:, j] = q[:, i : i + 1] * p
        row[:, i] = -q[:, j : j + 1] * p
        rows.append(row.reshape(-1, 9))
    h = np.linalg.svd(_triangle(np.concatenate(rows)))[2][-1].reshape(3, 3)
    matrix = np.linalg.inv(to_b) @ h @ to_a
    towards = np.sum((a @ matrix.T) * b, axis=1)
    return np.asarray(matrix if np.sum(towards) > 0 else -matrix)


def _normaliser(d: Floats) -> Floats:
    """Rotate the mean direction to z and scale slopes to unit rms (Hartley's normalisation)."""
    z = unit(d.mean(axis=0))
    frame = np.stack([*axes_across(z).T, z])
    across = d @ frame[:2].T
    spread = float(np.sqrt(np.mean(across**2))) or 1.0
    return np.asarray(np.diag([1 / spread, 1 / spread, 1.0]) @ frame)


# --------------------------------------------------------------------------------- Gauss–Newton

State = tuple[Floats, Floats, Floats]  # 1/η (2,), δ/η (2,), rotation (3, 3)


def _state(law: LawParameters) -> State:
    eta = np.array([law.eta_x, law.eta_y])
    return 1.0 / eta, np.array([law.delta_x, law.delta_y]) / eta, law.rotation


def _gauss_newton(
    power: Floats, offset: Floats, r: Floats, a: Floats, b: Floats, turn: bool, steps: int = 200
) -> State:
    """Least squares of the exit directions: Gauss–Newton, damped (Levenberg–Marquardt) where it fails."""
    state, damping = (power, offset, r), 0.0
    cost = _cost(state, a, b)
    for _ in range(steps):
        system = _linearised(state, a, b, turn)
        while (new := _cost(trial := _moved(state, _step(*system, damping)), a, b)) >= cost:
            damping = max(100.0 * damping, _LEAST_DAMPING)
            if damping > 1.0:  # even the steepest descent does not improve: this is the minimum
                return state
        gain, state, cost = cost - new, trial, new
        if gain <= 1e-13 * cost:
            return state
        damping = 0.0 if damping <= _LEAST_DAMPING else damping / 10.0
    return state


def _cost(state: State, a: Floats, b: Floats) -> float:
    return float(np.sum((_unit_exit(state, _in_lens(state, a))[0] - _in_lens(state, b)) ** 2))


def _in_lens(state: State, d: Floats) -> Floats:
    """Directions (n, 3) in the lens frame; unchanged if the frame is the identity."""
    return d if np.array_equal(state[2], np.eye(3)) else d @ state[2]


def _moved(state: State, step: Floats) -> State:
    """State after a step (Δ1/η, Δδ/η, rotation about the lens axes), with an exact rotation."""
    power, offset, r = state
    omega = step[4:]
    angle = float(np.linalg.norm(omega))
    if angle > 0.0:
        k = np.cross(np.eye(3), omega / angle) * -1.0  # k @ v = ω̂ × v
        r = r @ (np.eye(3) + np.sin(angle) * k + 2 * np.sin(angle / 2) ** 2 * (k @ k))
    return power + step[:2], offset + step[2:4], r


def _unit_exit(state: State, m: Floats) -> tuple[Floats, Floats]:
    """Unit exit directions (n, 3) in the lens frame, and their lengths before normalising (n, 1)."""
    w = np.stack([m[:, i] * state[0][i] - state[1][i] * m[:, 2] for i in range(2)] + [m[:, 2]], axis=1)
    length = lengths(w)[:, np.newaxis]
    return w / length, length


def _triangle(system: Floats) -> Floats:
    """R of the QR decomposition: the same least-squares problem in a few rows."""
    return np.asarray(np.linalg.qr(system, mode="r"), np.float64)


def _jacobian(state: State, a: Floats, turn: bool) -> tuple[Floats, Floats]:
    """∂(exit direction)/∂(1/η_x, 1/η_y, δ_x/η_x, δ_y/η_y, turn) (n, 3, 4 or 7), and the exit (n, 3)."""
    power, offset, r = state
    m = _in_lens(state, a)
    unit, length = _unit_exit(state, m)
    columns = np.zeros((len(a), 3, 7 if turn else 4))
    for i in range(2):
        columns[:, i, i] = m[:, i]
        columns[:, i, 2 + i] = -m[:, 2]
    if turn:  # w = exp(ω) M exp(−ω) m: dw = ω × w − M (ω × m)
        lens = np.array([[power[0], 0, -offset[0]], [0, power[1], -offset[1]], [0, 0, 1]])
        w = unit * length
        for i, axis in enumerate(np.eye(3)):
            columns[:, :, 4 + i] = np.cross(axis, w) - np.cross(axis, m) @ lens.T
    columns -= unit[:, :, np.newaxis] * np.einsum("nk,nkp->np", unit, columns)[:, np.newaxis, :]
    return columns / length[:, :, np.newaxis], unit


def _linearised(state: State, a: Floats, b: Floats, turn: bool) -> tuple[Floats, Floats, Floats, Floats]:
    """The least-squares problem of one step, unit columns: residual and values per mode, modes, scale."""
    jacobian, unit = _jacobian(state, a, turn)
    count = jacobian.shape[2]
    system = np.concatenate([jacobian, (_in_lens(state, b) - unit)[:, :, np.newaxis]], axis=2)
    triangle = _triangle(system.reshape(-1, count + 1))
    scale = np.linalg.norm(triangle[:, :count], axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    left, values, right = np.linalg.svd(triangle[:, :count] / scale, full_matrices=False)
    return left.T @ triangle[:, count], values, right, scale


def _step(residual: Floats, values: Floats, modes: Floats, scale: Floats, damping: float) -> Floats:
    """Step of length 7 (zeros for held parameters); modes that the rays do not determine stay 0."""
    seen = values > 1e-13 * values[0]
    weight = np.where(seen, values / np.where(seen, values**2 + damping * values[0] ** 2, 1.0), 0.0)
    step = np.zeros(7)
    step[: len(scale)] = modes.T @ (weight * residual) / scale
    return step


# ------------------------------------------------------------------------------------ judgement


def _exit(law: LawParameters, a: Floats) -> Floats:
    """Unit exit directions (n, 3), sheet frame."""
    state = _state(law)
    return _unit_exit(state, a @ state[2])[0] @ state[2].T


def _covariance(law: LawParameters, a: Floats, b: Floats, count: int) -> tuple[Floats, int]:
    """Covariance (7, 7) of the parameters and the rank of the fit, from the Jacobian at its end."""
    state = _state(law)
    jacobian, unit = _jacobian(state, a, turn=True)
    design = (jacobian @ _chain(law))[:, :, :count].reshape(-1, count)
    # η and δ scaled by their effect on the rays, angles per radian: φ of an almost round lens is then
    # undetermined.
    scale = np.full(count, np.sqrt(len(a)))
    scale[:4] = np.linalg.norm(design[:, :4], axis=0)
    scale[scale == 0.0] = 1.0
    _, values, right = np.linalg.svd(_triangle(design / scale), full_matrices=False)
    seen = values > _KNOWN * values[0]
    rank = int(seen.sum())
    residual = float(np.sum((b @ state[2] - unit) ** 2))
    variance = residual / max(2 * len(a) - rank, 1)
    spread = right[seen].T / values[seen]
    covariance = np.zeros((7, 7))
    covariance[:count, :count] = variance * (spread @ spread.T) / np.outer(scale, scale)
    unseen = np.any(np.abs(right[~seen]) > 1e-6, axis=0)
    where = np.flatnonzero(unseen)
    covariance[where, where] = np.inf
    return covariance, rank


def _chain(law: LawParameters) -> Floats:
    """∂(1/η, δ/η, turn in the lens frame)/∂(η, δ, φ, θ, ψ), (7, 7)."""
    chain = np.zeros((7, 7))
    for i, (eta, delta) in enumerate(((law.eta_x, law.delta_x), (law.eta_y, law.delta_y))):
        chain[i, i] = -1.0 / eta**2
        chain[2 + i, i] = -delta / eta**2
        chain[2 + i, 2 + i] = 1.0 / eta
    r = law.rotation
    chain[4:, 4] = (0.0, 0.0, 1.0)  # φ rotates about the lens's own axis,
    chain[4:, 5] = (np.cos(law.phi), -np.sin(law.phi), 0.0)  # θ about Rz(φ)ᵀ e_x,
    chain[4:, 6] = r[2]  # ψ about the sheet's z
    return chain
