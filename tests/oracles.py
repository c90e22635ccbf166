"""Independent solutions that tests compare with; nothing here uses the package's solvers."""

import numpy as np
from scipy.integrate import cumulative_simpson, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.special import erfc


def t2_q(x):
    """Scene T2: a bump and a hollow."""
    return 0.8 * np.exp(-((x + 5) ** 2)) - 0.3 * np.exp(-(((x + 3) / 0.5) ** 2))


def t2_W(x):
    """∫ q of T2 from -infinity."""
    root_pi = np.sqrt(np.pi)
    return 0.4 * root_pi * erfc(-(x + 5)) - 0.075 * root_pi * erfc(-(x + 3) / 0.5)


def t2_smooth_solution(t, left=-10.0, labels=8001):
    """u - x of T2 with f = q/(1+q) at a time before its first shock, as a spline over x.

    Characteristics in the label (maths of §4): q' = K f², X' = K f', I = W + 1 + q constant, and
    ln K = ln R(q) - ln R(q at x = 0) + ∫ I'/R over the labels in between. Simpson's rule on 8001 labels and an
    adaptive eighth-order time step: good to about 1e-10.
    """
    xi = np.linspace(left, 0.0, labels)
    q0, I = t2_q(xi), t2_W(xi) + 1.0 + t2_q(xi)
    slope = t2_q(xi) + (
        -1.6 * (xi + 5) * np.exp(-((xi + 5) ** 2)) + 0.3 * 8 * (xi + 3) * np.exp(-(((xi + 3) / 0.5) ** 2))
    )

    def rate(_, state):
        q, X = np.split(state, 2)
        R = 1.0 + q
        swept = cumulative_simpson(slope / R, x=xi, initial=0.0)
        log_K = np.log(R) - swept
        at_top = CubicSpline(X, log_K)(0.0)  # X increases before the shock
        K = np.exp(log_K - at_top)
        return np.concatenate([K * (q / R) ** 2, K / R**2])

    end = solve_ivp(rate, (0.0, t), np.concatenate([q0, xi]), method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    q, X = np.split(end, 2)
    W = CubicSpline(X, I - 1.0 - q)
    return W


def kinks_until_meeting(positions, amplitudes, end):
    """Kinks of the rational law followed exactly by ODEs until two meet; the positions as a dense solution."""
    J = [a + w for a, w in zip(amplitudes, _W_at(positions, amplitudes), strict=True)]
    return _follow(np.array(positions), J, 0.0, end)


def kinks_to_the_end(positions, amplitudes, end):
    """As above through all merges and exits: a list of (time, event, place), and the positions at the end."""
    events, t, s = [], 0.0, np.array(positions)
    J = [a + w for a, w in zip(amplitudes, _W_at(positions, amplitudes), strict=True)]
    while s.size and t < end:
        part = _follow(s, J, t, end)
        t, s = float(part.t[-1]), part.y[:, -1]
        if part.t_events[0].size:
            j = int(np.argmin(np.diff(s)))
            events.append((t, "merge", float(s[j])))
            s, J = np.delete(s, j), J[:j] + J[j + 1 :]
        elif part.t_events[1].size:
            events.append((t, "exit", 0.0))
            s, J = s[:-1], J[:-1]
    return events, s


def _W_at(positions, amplitudes):
    """W at each kink: q = A e^{-(x - s)} right of it."""
    W = [0.0]
    for s0, s1, a in zip(positions[:-1], positions[1:], amplitudes[:-1], strict=True):
        W.append(W[-1] + a * (1 - np.exp(-(s1 - s0))))
    return W


def _follow(positions, J, start, end):
    """Integrates the kinks' places until two meet or one reaches x = 0. J = q + W is constant between kinks."""

    def sweep(s):
        """One-sided q at each kink, from left to right."""
        left, right = [], []
        W, q, at = 0.0, 0.0, s[0]
        for j in range(len(s)):
            decay = np.exp(-(s[j] - at))
            W, q, at = W + q * (1 - decay), q * decay, s[j]
            left.append(q)
            q = J[j] - W
            right.append(q)
        return np.array(left), np.array(right)

    def rate(_, s):
        left, right = sweep(s)
        K = np.ones(len(s))
        above, x = 1.0, 0.0  # K is proportional to 1 + q between kinks
        for j in reversed(range(len(s))):
            K[j] = above * (1 + right[j]) / (1 + right[j] * np.exp(-(x - s[j])))
            above, x = K[j], s[j]
        return K / ((1 + left) * (1 + right))

    def meet(_, s):
        return np.min(np.diff(s)) if len(s) > 1 else 1.0

    def leave(_, s):
        return s[-1]

    meet.terminal = leave.terminal = True
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "dense_output": True}
    return solve_ivp(rate, (start, end), positions, events=[meet, leave], **options)


def muscl_hancock(q, law, dx, dt, floor_share, k=None):
    """One step of the second-order conservative scheme, cell by cell; also K at the left end and F at x = 0.

    The factor is K of q, or k at the nodes, given for the half step.
    """
    n = q.size
    F = np.zeros(n + 1)
    K = 1.0 if k is None else k[n]
    for i in range(n - 1, -1, -1):
        ahead = q[i + 1] - q[i] if i < n - 1 else q[i] - q[i - 1]
        back = q[i] - q[i - 1] if i > 0 else q[i + 1] - q[i]
        half = 0.0
        if ahead * back > 0:
            half = np.sign(ahead) * min(abs(ahead), abs(back), 0.25 * abs(ahead + back))
        half = float(np.clip(half, -floor_share * (1 + q[i]), floor_share * (1 + q[i])))
        f, df = float(law.f(q[i])), float(law.derivative(q[i]))
        rise = 0.5 * dt * K * (1 + 0.5 * f * dx) * (f * f - df * 2 * half / dx)  # q_t = K f² - K f' q_x
        if k is not None:  # q_t = -k_x f - k f' q_x
            rise = -0.5 * dt / dx * ((k[i + 1] - k[i]) * f + (k[i + 1] + k[i]) * df * half)
        F[i + 1] = K * float(law.f(q[i] + half + rise))
        z = max((f + df * rise) * dx, -1.0)
        K = K * (1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24) if k is None else k[i]
    return q - dt / dx * np.diff(F), K, F[n]


def characteristics_with_coefficient(law, q0, left, t, k):
    """x and q at time t of a smooth solution of q_t + (k f(q))_x = 0, along characteristics from 3000 places."""
    x = np.linspace(left, 0.0, 3000)
    if t == 0.0:
        return x, q0(x)
    h = 1e-3  # sixth-order differences of k: h⁶ of its seventh derivative

    def k_x(t, x):
        return sum(c * (k(t, x + j * h) - k(t, x - j * h)) for j, c in ((1, 0.75), (2, -0.15), (3, 1 / 60))) / h

    def rate(t, y):
        x, q = np.split(y, 2)
        return np.concatenate([k(t, x) * law.derivative(q), -k_x(t, x) * law.f(q)])

    y = solve_ivp(rate, (0.0, t), np.concatenate([x, q0(x)]), method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    return np.split(y, 2)


def means_of_samples(x, q, nodes):
    """Means over cells of the spline of fifth degree through samples; q = 0 left of them."""
    from scipy.interpolate import make_interp_spline

    W = make_interp_spline(x, q, k=5).antiderivative()(np.clip(nodes, x[0], x[-1]))
    return np.diff(W) / np.diff(nodes)


def resolved_layer(q, left, thickness, end):
    """Cell means of q and of h below a rolling layer, in the paper's own variables and its own, fast time [eq2].

    h_t - (h p)_x = (p-1) h, p_t + ((p-1) h)_x = 0, h p = thickness at x = 0, no layer at first; upwind with limited
    linear reconstruction (minmod), the source by cell means, Heun's steps that resolve the layer's fast time.
    """
    n = q.size
    dx, t, last = -left / n, 0.0, end / thickness

    def limited(v, before, after):
        back, ahead = np.diff(v, prepend=before), np.diff(v, append=after)
        return 0.5 * np.where(back * ahead > 0, np.sign(back) * np.minimum(np.abs(back), np.abs(ahead)), 0.0)

    def rates(h, p):
        half_h, half_p = limited(h, h[0], thickness / p[-1]), limited(p, p[0], p[-1])
        grains = np.append((h - half_h) * (p - half_p), thickness)  # run to the left
        eroded = np.append(0.0, (h + half_h) * (p + half_p - 1))  # slopes run to the right
        return np.diff(grains) / dx + (p - 1) * h, -np.diff(eroded) / dx

    h, p = np.zeros(n), 1 + q
    while t < last:
        dt = min(0.4 * dx / np.max(p + h), last - t)
        h1, p1 = (v + dt * r for v, r in zip((h, p), rates(h, p), strict=True))
        h, p = (0.5 * (v + w + dt * r) for v, w, r in zip((h, p), (h1, p1), rates(h1, p1), strict=True))
        t += dt
    return p - 1, h


def kinks_on_the_line(positions, amplitudes, times):
    """Places of the rational law's kinks on the whole line, before two meet, and K there; shape (kinks, times).

    q decays from each like e^{-x}, for ever right of the last; K(∞) = 1 and K/(1+q) is constant in between.
    """
    J = np.array([a + w for a, w in zip(amplitudes, _W_at(positions, amplitudes), strict=True)])

    def state(s):
        met, right, W = np.zeros(s.size), np.empty(s.size), 0.0
        for j in range(s.size):
            if j:
                met[j] = right[j - 1] * np.exp(s[j - 1] - s[j])
                W = J[j - 1] - met[j]
            right[j] = J[j] - W
        K, factor = np.empty(s.size), 1.0
        for j in range(s.size - 1, -1, -1):
            factor *= (1 + right[j]) / (1 + (met[j + 1] if j + 1 < s.size else 0.0))
            K[j] = factor
        return K, met, right

    def rate(_, s):
        K, met, right = state(s)
        return K / ((1 + met) * (1 + right))

    path = solve_ivp(rate, (0.0, times[-1]), positions, method="DOP853", rtol=1e-13, atol=1e-13, t_eval=times).y
    return path, np.array([state(s)[0] for s in path.T]).T
