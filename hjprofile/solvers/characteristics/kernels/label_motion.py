"""Loops of shock-fitted characteristics: rates of r = R(q) and X over labels, steps, and evaluation (§14).

The conventions are those of `kernels.labels`.
"""

import math

import numpy as np

from hjprofile.solvers.characteristics.kernels.labels import (
    MAX_LOCAL,
    RESIDUAL_FOUND,
    RESIDUAL_LOST,
    after_start,
    at_label,
    before_end,
    dot,
    law_terms,
    shock_labels,
    weights,
)
from hjprofile.solvers.kernels import compiled
from hjprofile.solvers.kernels.dormand_prince import STAGES, interpolant, state_at, step_error

FOUND_ALL, NOT_ADMISSIBLE = 0, -1  # values that `find_labels` returns, besides 1 + k if the labels of shock k are lost


@compiled
def find_labels(y, t, medium, shocks, unborn):
    """Find the labels of shocks and of x = 0; return FOUND_ALL, NOT_ADMISSIBLE or 1 + k for a lost shock k.

    Of a shock born at the time `unborn`, whose fold the state does not contain yet, only the age is used.
    """
    mesh, rule, law = medium.mesh, medium.rule, medium.law
    P, n = mesh.I.shape
    r, X = y[: P * n].reshape(P, n), y[P * n : 2 * P * n].reshape(P, n)
    w, count = np.empty(n), shocks.off.shape[0]
    for p in range(P):
        for i in range(n):
            if not r[p, i] > 0.0:
                return NOT_ADMISSIBLE
    for k in range(count):
        if shocks.power[k, 1] > 0.0:
            age = t - shocks.birth[k]
            if age <= 0.0:
                continue
            for side in range(2):
                shocks.off[k, side] *= (age / shocks.tau[k]) ** shocks.power[k, side]
            shocks.tau[k] = age
            if shocks.birth[k] == unborn:
                continue
        if not shock_labels(k, shocks.off, r, X, mesh, rule, law, w):
            return 1 + k
    at, crest_X, rounding = shocks.crest[0], 0.0, 1.0
    for _ in range(30):  # the label at x = 0
        p, s = before_end(at, count, mesh)
        if not abs(s) <= MAX_LOCAL:
            return NOT_ADMISSIBLE
        _, crest_X, _, slope = at_label(p, s, r, X, mesh, rule, w)
        rounding = max(1.0, abs(crest_X))
        crest_X += mesh.base[p]
        if abs(crest_X) <= RESIDUAL_FOUND * rounding or not slope > 0.0:
            break
        at += crest_X * mesh.half[p] / slope
    if not abs(crest_X) <= RESIDUAL_LOST * rounding:
        return NOT_ADMISSIBLE
    shocks.crest[0] = at
    return FOUND_ALL


@compiled
def find_flux(r, medium, shocks, stages):
    """Fill S and c of ln K = ln r + S + c, from right to left; return r at x = 0."""
    mesh, rule, S, c = medium.mesh, medium.rule, stages.S, stages.c
    n, count = mesh.I.shape[1], shocks.off.shape[0]
    w = np.empty(n)
    for k in range(count + 1):
        right = 0.0
        for p in range(mesh.first[k + 1] - 1, mesh.first[k] - 1, -1):
            for i in range(n):
                S[p, i] = right
            for j in range(n):
                g = mesh.dI[p, j] / r[p, j]
                for i in range(n):
                    S[p, i] += g * rule.B[j, i]
            right = S[p, 0]
    p, s = before_end(shocks.crest[0], count, mesh)
    weights(rule, s, w)
    crest = dot(w, r, p)
    c[count] = -math.log(crest) - dot(w, S, p)
    for k in range(count - 1, -1, -1):
        p, s = after_start(shocks.off[k, 1], k + 1, mesh)
        weights(rule, s, w)
        log_K = math.log(dot(w, r, p)) + dot(w, S, p) + c[k + 1]
        if mesh.first[k] < mesh.first[k + 1]:
            p, s = before_end(shocks.off[k, 0], k, mesh)
            weights(rule, s, w)
            c[k] = log_K - math.log(dot(w, r, p)) - dot(w, S, p)
        else:
            c[k] = log_K  # of the neutral slope on the left
    return crest


@compiled
def rates(y, t, medium, shocks, stages, unborn, out):
    """Fill dy/dt for y = (r, X, ∫(K_left - 1), ∫F(0)), with labels and flux; return the result of `find_labels`."""
    mesh, law = medium.mesh, medium.law
    P, n = mesh.I.shape
    found = find_labels(y, t, medium, shocks, unborn)
    if found != FOUND_ALL:
        return found
    r = y[: P * n].reshape(P, n)
    crest = find_flux(r, medium, shocks, stages)
    for k in range(shocks.off.shape[0] + 1):
        for p in range(mesh.first[k], mesh.first[k + 1]):
            for i in range(n):
                K = r[p, i] * math.exp(stages.S[p, i] + stages.c[k])
                f, f1, _ = law_terms(r[p, i], law)
                out[p * n + i] = K * f * f / (f + f1)
                out[P * n + p * n + i] = K * f1 / (r[p, i] * (f + f1))
    log_K = stages.c[0]
    if mesh.first[0] < mesh.first[1]:
        log_K += math.log(r[0, 0]) + stages.S[0, 0]
    out[2 * P * n] = math.exp(log_K) - 1.0
    out[2 * P * n + 1] = law_terms(crest, law)[0]
    return FOUND_ALL


@compiled
def step(y, start, h, origin, tableau, medium, shocks, stages, new):
    """Fill `new` by a step by h > 0 from `start`, in t, or in z = sqrt(t - origin) if `origin` is not NaN.

    Return the error estimate (largest entry), and the result of `find_labels`.
    """
    for i in range(STAGES + 1):
        found = _stage(i, y, start, h, origin, tableau, medium, shocks, stages, new)
        if found != FOUND_ALL:
            return math.inf, found
    return step_error(h, stages.rates, tableau, new, 0), FOUND_ALL


@compiled
def within(y, start, h, origin, tableau, medium, shocks, stages, new, F):
    """Fill the coefficients F of `state_within` after a step of `step`; return the result of `find_labels`."""
    state = np.empty(y.size)
    for i in range(STAGES + 1, STAGES + 4):
        found = _stage(i, y, start, h, origin, tableau, medium, shocks, stages, state)
        if found != FOUND_ALL:
            return found
    interpolant(y, h, stages.rates, tableau, new, F)
    return FOUND_ALL


@compiled
def _stage(i, y, start, h, origin, tableau, medium, shocks, stages, state):
    """Fill the state and the rate of stage i; return the result of `find_labels`."""
    k, in_root = stages.rates, origin == origin
    state_at(i, y, h, k, tableau, state)
    part = 1.0
    if i != STAGES:
        part = np.sum(tableau.A[i]) if i < STAGES else np.sum(tableau.A_more[i - STAGES - 1])
    z = start + h * part
    t = origin + z * z if in_root else z
    # all derivatives by z vanish at a birth: the second stage has the state of the first, at a later time
    unborn = origin if i == 1 and start == 0.0 else math.nan
    found = rates(state, t, medium, shocks, stages, unborn, k[i])
    if found == FOUND_ALL and in_root:
        for l in range(y.size):
            k[i, l] *= 2.0 * z
    return found


@compiled
def _label_of_place(p, x, s, ends, r, X, mesh, rule, w):
    """Return the label of panel p, between the two ends, at position x: Newton's method from s, within a bracket."""
    a, b = ends
    for _ in range(60):
        _, at, _, slope = at_label(p, s, r, X, mesh, rule, w)
        beyond = at - (x - mesh.base[p])
        if beyond > 0.0:
            b = s
        else:
            a = s
        if abs(beyond) <= 1e-15 * max(1.0, abs(at)):
            break
        trial = s - beyond / slope if slope > 0.0 else a
        s = trial if a < trial < b else 0.5 * (a + b)
    return s


@compiled
def read(y, mesh, rule, low, high, stages, nodes, W_out, K_out):
    """Fill W and K at increasing `nodes`, panel by panel over the living labels low[p] <= s <= high[p] between shocks.

    The flux is the one that `rates` computed last.
    """
    S, c = stages.S, stages.c
    P, n = mesh.I.shape
    r, X = y[: P * n].reshape(P, n), y[P * n : 2 * P * n].reshape(P, n)
    w = np.empty(n)
    left, right = np.empty(P), np.empty(P)
    of = np.zeros(P, dtype=np.int64)
    for k in range(mesh.first.size - 1):
        of[mesh.first[k] : mesh.first[k + 1]] = k
    p = 0
    for p in range(P):
        weights(rule, low[p], w)
        left[p] = mesh.base[p] + dot(w, X, p)
        weights(rule, high[p], w)
        right[p] = mesh.base[p] + dot(w, X, p)
    p = 0
    s = -1.0
    for i in range(nodes.size):
        x = nodes[i]
        while p < P - 1 and (high[p] <= low[p] or x > right[p]):
            p += 1
            s = low[p]
        a, b = low[p], high[p]
        if x <= left[p]:  # left of all labels, where q = 0, or within rounding of a shock
            s = a
        elif x >= right[p]:
            s = b
        else:
            s = _label_of_place(p, x, min(max(s, a), b), (a, b), r, X, mesh, rule, w)
        weights(rule, s, w)
        value = dot(w, r, p)
        W_out[i] = dot(w, mesh.I, p) - value
        K_out[i] = value * math.exp(dot(w, S, p) + c[of[p]])
        if x < left[p] and p == first_alive(low, high):
            W_out[i] = 0.0


@compiled
def first_alive(low, high):
    """Return the first panel with a living label."""
    for p in range(low.size):
        if high[p] > low[p]:
            return p
    return low.size - 1
