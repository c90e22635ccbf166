"""Sweep of the 2x2 model for the rolling layer, of which slow erosion is the limit (§15).

Nodes have the indices 0..N, cells 0..N-1; cell i lies between nodes i and i+1. Grains roll from node N to node 0.
"""

import numpy as np

from hjprofile.solvers.kernels import compiled


@compiled
def layer_pass(q, H, m, F, dx, dt, steps, bound, supply_flux, inflow):
    """Advance q and H by `steps` time steps in place, and set m to the grain flux at the nodes in the last one.

    H is the thickness of the rolling layer and m the grain flux, both relative to the supplied flux ε = `supply_flux`.

    The sweep runs downslope and is implicit, so the time in which grains run down needs no time steps of its own. With
    c the flux out of a cell without exchange, and g ≈ exp(f dx),

        m_i + (ε dx/dt) H_i = m_{i+1} + (ε dx/dt) H_i^old + (m_i - c_i),   m_i = c_i g_i,   H_i = m_i/p_i .

    The bed loses F_{i+1} = (m_i - c_i)/dx per unit length, which the layer gains. F is a work array.

    Return the largest speed, ∫(m_0 - 1) dt including the grains added to the layer, and ∫F_N dt. The speed bounds F/q,
    which preserves the sign of q, and dF/dq; it is infinite if p <= 0. No further step is made after a step in which
    the speed exceeds `bound`: arriving grains can increase it several times.
    """
    n = q.size
    speed = toe_gain = crest_lowering = 0.0
    supply_mass_per_H = supply_flux * dx
    for _ in range(steps):
        if speed > bound:
            break
        m[n] = 1.0
        for i in range(n - 1, -1, -1):
            p = 1.0 + q[i]
            if not p > 0.0:
                return np.inf, toe_gain, crest_lowering
            z = q[i] / p * dx
            w = max(z, -1.0)
            g = 1.0 + w + 0.5 * w * w
            c = p * (dt * m[i + 1] + supply_mass_per_H * H[i]) / (dt * p + supply_mass_per_H * g)
            F[i] = c * (g - 1.0) / dx
            m[i] = c * g
            toe_gain += supply_mass_per_H * (m[i] / p - H[i])
            H[i] = m[i] / p
            speed = max(speed, c / min(p, p * p) * (1.0 + max(z, 0.0)))
        toe_gain += dt * (m[0] - 1.0)
        before = inflow
        for i in range(n):
            q[i] -= dt / dx * (F[i] - before)
            before = F[i]
        crest_lowering += dt * before
    return speed, toe_gain, crest_lowering
