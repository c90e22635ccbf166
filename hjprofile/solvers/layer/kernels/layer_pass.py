"""The rolling layer above the bed: the 2x2 model that slow erosion is the limit of (theory, §8).

Nodes carry index 0..N, cells 0..N-1; cell i lies between nodes i and i+1. Grains run from node N to node 0.
"""

import numpy as np

from hjprofile.solvers.kernels import compiled


@compiled
def layer_pass(q, H, m, F, dx, dt, steps, bound, supply_flux, inflow):
    """`steps` steps of q and of H, the thickness of the layer in units of the poured flux ε = `supply_flux`, in place.

    With them m, the flux of grains at the nodes in the last step, in units of ε.

    From the top down, implicitly, so that the time grains take to run down needs no steps of its own: with
    c the flux that would leave a cell if nothing were exchanged, and g ≈ exp(f dx),

        m_i + (ε dx/dt) H_i = m_{i+1} + (ε dx/dt) H_i^old + (m_i - c_i),   m_i = c_i g_i,   H_i = m_i/p_i .

    The bed loses F_{i+1} = (m_i - c_i)/dx per unit length, which is what the layer gains. F is room for that.

    Returns the largest speed met, ∫(m_0 - 1) dt with the grains that were added to the layer, and ∫F_N dt. The speed
    bounds both F/q, by which slopes keep their sign, and dF/dq; it is infinite where p <= 0. After a step in which it
    was more than `bound` no other is taken: grains that arrive can make it several times what it was.
    """
    n = q.size
    speed = growth = crest_lowering = 0.0
    held = supply_flux * dx
    for _ in range(steps):
        if speed > bound:
            break
        m[n] = 1.0
        for i in range(n - 1, -1, -1):
            p = 1.0 + q[i]
            if not p > 0.0:
                return np.inf, growth, crest_lowering
            z = q[i] / p * dx
            w = max(z, -1.0)
            g = 1.0 + w + 0.5 * w * w
            c = p * (dt * m[i + 1] + held * H[i]) / (dt * p + held * g)
            F[i] = c * (g - 1.0) / dx
            m[i] = c * g
            growth += held * (m[i] / p - H[i])
            H[i] = m[i] / p
            speed = max(speed, c / min(p, p * p) * (1.0 + max(z, 0.0)))
        growth += dt * (m[0] - 1.0)
        before = inflow
        for i in range(n):
            q[i] -= dt / dx * (F[i] - before)
            before = F[i]
        crest_lowering += dt * before
    return speed, growth, crest_lowering
