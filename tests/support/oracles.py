"""Independent solutions that tests compare with; nothing here uses the package's solvers."""

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson, solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
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


def check_kinks(run, exact, tolerance):
    """Assert that `run` lists the one kink of a closed form: place, q on its sides and speed."""
    h = 1e-4  # central differences: h² of the third derivative, below 1e-7 of the speed
    for k in run.kinks:
        s = exact.path(k.time)
        (_, left, right), *_ = exact.at(s).breaks(exact.law)
        assert (k.kink, k.x) == (1, pytest.approx(s, abs=tolerance))
        assert (k.q_left, k.q_right, k.jump) == pytest.approx((left, right, right - left), abs=100.0 * tolerance)
        if h < k.time < exact.exit_time - h:
            speed = (exact.path(k.time + h) - exact.path(k.time - h)) / (2.0 * h)
            assert (k.speed, k.rankine_hugoniot_speed) == pytest.approx((speed, speed), rel=1e-6)
    assert [k.time for k in run.kinks] == [t for t in run.time if t < exact.exit_time]


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


def resolved_layer(q, left, supply_flux, end):
    """Cell means of q and of h below a rolling layer, in the paper's own variables and its own, fast time T (1.6).

    h_T - (h p)_x = (p-1) h, p_T + ((p-1) h)_x = 0, h p = supply_flux at x = 0, no layer at first; upwind with limited
    linear reconstruction (minmod), the source by cell means, Heun's steps that resolve the layer's fast time. The flux
    is a function of the supplied mass t, which is integrated along: dt = supply_flux(t) dT. It ends at t = end.
    """
    n = q.size
    dx, t = -left / n, 0.0

    def limited(v, before, after):
        back, ahead = np.diff(v, prepend=before), np.diff(v, append=after)
        return 0.5 * np.where(back * ahead > 0, np.sign(back) * np.minimum(np.abs(back), np.abs(ahead)), 0.0)

    def rates(h, p, flux):
        half_h, half_p = limited(h, h[0], flux / p[-1]), limited(p, p[0], p[-1])
        grains = np.append((h - half_h) * (p - half_p), flux)  # run to the left
        eroded = np.append(0.0, (h + half_h) * (p + half_p - 1))  # slopes run to the right
        return np.diff(grains) / dx + (p - 1) * h, -np.diff(eroded) / dx

    h, p = np.zeros(n), 1 + q
    while t < end * (1 - 1e-12):
        dT, flux = 0.4 * dx / np.max(p + h), supply_flux(t)
        dT = min(dT, 2 * (end - t) / (flux + supply_flux(end)))
        flux1 = supply_flux(t + dT * flux)
        h1, p1 = (v + dT * r for v, r in zip((h, p), rates(h, p, flux), strict=True))
        h, p = (0.5 * (v + w + dT * r) for v, w, r in zip((h, p), (h1, p1), rates(h1, p1, flux1), strict=True))
        t += 0.5 * dT * (flux + flux1)
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


# Linear growth, f = q + q/(1+q): R = (1+q)/(2+q), and with z = 1/(1+q) = x_u the equation is x_t = K (1 - z²)


def steep_q(r):
    """q at which R = r."""
    return (2.0 * r - 1.0) / (1.0 - r)


def bump_blow_up(amplitude, width, labels=4001, reach=6.0):
    """Time at which q = amplitude exp(-(x/width)²) becomes infinite, far from the top, by characteristics.

    Over labels dR/dt = K (f - q f') = K ((2R-1)/R)², regular through R = 1, with ln K from the labels above it. The
    largest R by a spline; good to 1e-10. Also the least X_ξ above it then: positive where no shock has come between.
    """
    xi = np.linspace(-reach * width, reach * width, labels)
    q = amplitude * np.exp(-((xi / width) ** 2))
    q_xi = -2.0 * xi / width**2 * q
    r0, r_xi = (1.0 + q) / (2.0 + q), q_xi / (2.0 + q) ** 2
    I_xi = q + r_xi

    def rate(_, r):
        swept = cumulative_simpson((I_xi / r)[::-1], dx=xi[1] - xi[0], initial=0.0)[::-1]
        K = np.exp(np.log(r / 0.5) + swept)
        return K * ((2.0 * r - 1.0) / r) ** 2

    def room(_, r):
        k = int(np.argmax(r))
        spline = CubicSpline(xi[k - 8 : k + 9], r[k - 8 : k + 9])
        return 1.0 - max(spline(x) for x in spline.derivative().roots(extrapolate=False))

    room.terminal = True
    run = solve_ivp(rate, (0.0, 10.0), r0, method="DOP853", rtol=1e-12, atol=1e-13, events=room)
    r = run.y[:, -1]
    with np.errstate(all="ignore"):
        stretch = (I_xi - CubicSpline(xi, r).derivative()(xi)) / steep_q(r)
    above = (xi >= xi[np.argmax(r)]) & (r < 0.999) & (steep_q(r) > 1e-3)
    return float(run.t[-1]), float(np.min(stretch[above]))


def isotonic_profile(W, left, end, cells):
    """x(u) at a time under f = q + q/(1+q), from a function W(x) = u - x, by the inverse formulation.

    That is x_t = K (1 - x_u²).

    First-order upwind in u, telescoping in K, with x kept non-decreasing by isotonic regression: where x is level u
    jumps, and the pooled nodes move with their mean velocity. Nothing is known here of characteristics or fronts.
    """
    from scipy.optimize import isotonic_regression

    fine = np.linspace(left, 0.0, 400_001)
    heights = fine + W(fine)
    u = np.linspace(heights[0], heights[-1], cells + 1)
    x, du, t = np.interp(u, heights, fine), (heights[-1] - heights[0]) / cells, 0.0
    while t < end:
        z = np.diff(x) / du
        ln_K = np.append(np.cumsum(((1.0 - z**2) * du)[::-1])[::-1], 0.0)
        if x[-1] > 0.0:
            ln_K -= np.interp(0.0, x, ln_K)  # K = 1 at x = 0
        K = np.exp(ln_K)
        dt = min(0.4 * du / (2.0 * np.max(K[1:] * np.maximum(z, 0.5))), end - t)
        x[1:] += dt * (K[:-1] - K[1:]) / du
        x = isotonic_regression(x).x
        t += dt
    return u, x


def longest_step(u, x):
    """Where x(u) is level over the longest stretch: place, and height (to one spacing of u)."""
    starts = np.flatnonzero(np.append(True, np.diff(x) > 1e-12))
    lengths = np.diff(np.append(starts, x.size))
    k = int(np.argmax(lengths))
    return float(x[starts[k]]), float((lengths[k] - 1) * (u[1] - u[0]))


class SteepPair:
    """Two kinks under f = q + q/(1+q) until the step that they make leaves, in the inverse formulation.

    With x = x(t, u), z = x_u and x_t = K (1 - z²), K_u = -K (1 - z²), a piece of constant I = W + R is
    x = u - I + 1/(1+z) with z = Z(u - c), Z' = (1-Z)(1+Z)², K (1+z) the same all along it, and c' = K (1+z). A kink at
    height u moves by u' = K (z⁻ + z⁺), x being continuous. Where z would fall below 0 it is 0 over a stretch m of u at
    one place s, with s' = (K⁻ - K⁺)/m, K⁻ = K⁺ e^m; its ends are where x(u) of the pieces is s.

    Attributes: blow_up, merge, leave, the times of these; `step(t)` place and height; `growth` = ∫(K_left - 1) dt.
    """

    def __init__(self, positions, amplitudes, end):
        (s0, s1), (z0, z1) = positions, 1.0 / (1.0 + np.array(amplitudes))
        self.I1 = 0.5 - 0.5 + 1.0 / (1.0 + z0)
        c1 = s0 - self._B(z0)
        met = self._z_at(s1, self.I1, c1)
        u_b = s1 + self.I1 - 1.0 / (1.0 + met)
        self.I2 = u_b - s1 + 1.0 / (1.0 + z1)
        c2 = u_b - self._B(z1)
        how = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "dense_output": True}
        self.parts = []

        def rate_before(_, y):
            c1, c2, u_a, u_b, _ = y
            z_top, low, high = self._top(c2), self._Z(u_b - c1), self._Z(u_b - c2)
            K = (1.0 + z_top) / (1.0 + high)
            along = K * (1.0 + low)  # K (1+z) on the first piece
            return [along, 1.0 + z_top, along, K * (low + high), along / (1.0 + self._Z(u_a - c1)) - 1.0]

        def vertical(_, y):
            return y[3] - y[1]

        vertical.terminal = True
        run = solve_ivp(rate_before, (0.0, end), [c1, c2, s0, u_b, 0.0], events=vertical, **how)
        self.blow_up = float(run.t[-1])
        c1, c2, u_a, u_b, grown = run.y[:, -1]
        place = u_b - self.I2 + 1.0

        def rate_after(_, y):
            c1, c2, u_a, s, _ = y
            low, high, m = self._ends(c1, c2, s)
            z_top = self._top(c2)
            K = (1.0 + z_top) / (1.0 + high)
            along = K * np.exp(m) * (1.0 + low)
            speed = K * (np.expm1(m) / m if m > 1e-12 else 1.0)
            return [along, 1.0 + z_top, along, speed, along / (1.0 + self._Z(u_a - c1)) - 1.0]

        def meets(_, y):
            return y[3] - y[2]  # x = u left of the first kink

        meets.terminal = True
        run = solve_ivp(
            rate_after, (self.blow_up, end), [c1, c2, u_a, place, grown], events=meets, first_step=1e-8, **how
        )
        self.parts.append((run, lambda y: self._ends(y[0], y[1], y[3])[2], 3))
        self.merge = float(run.t[-1])
        _, c2, _, place, grown = run.y[:, -1]

        def rate_alone(_, y):
            c2, s, _ = y
            z_top, high = self._top(c2), self._z_at(s, self.I2, c2)
            m = self.I2 - 1.0 / (1.0 + high)
            K = (1.0 + z_top) / (1.0 + high)
            return [1.0 + z_top, K * np.expm1(m) / m, K * np.exp(m) - 1.0]

        def leaves(_, y):
            return -y[1]

        leaves.terminal = True
        run = solve_ivp(rate_alone, (self.merge, end), [c2, place, grown], events=leaves, **how)
        self.parts.append((run, lambda y: self.I2 - 1.0 / (1.0 + self._z_at(y[1], self.I2, y[0])), 1))
        self.leave, self.growth = float(run.t[-1]), float(run.y[2, -1])

    def step(self, t):
        """Place and height of the step."""
        run, height, index = next(p for p in self.parts if t <= p[0].t[-1])
        y = run.sol(t)
        return float(y[index]), float(height(y))

    @staticmethod
    def _B(z):
        """u - c where Z = z."""
        return 0.25 * np.log((1.0 + z) / (1.0 - z)) + 0.5 * z / (1.0 + z)

    def _Z(self, u):
        return brentq(lambda z: self._B(z) - u, -0.5, 1.0 - 1e-16, xtol=1e-15)

    def _z_at(self, x, I, c):
        """z at a place of a piece, where u = x + I - 1/(1+z)."""
        return brentq(lambda z: x + I - 1.0 / (1.0 + z) - c - self._B(z), 0.0, 1.0 - 1e-16, xtol=1e-15)

    def _top(self, c2):
        return self._z_at(0.0, self.I2, c2)

    def _ends(self, c1, c2, s):
        """z at either end of the step at s, and its height."""
        low = self._z_at(s, self.I1, c1)
        high = self._z_at(s, self.I2, c2) if s + self.I2 - 1.0 - c2 > 0.0 else 0.0
        return low, high, self.I2 - 1.0 / (1.0 + high) - (self.I1 - 1.0 / (1.0 + low))
