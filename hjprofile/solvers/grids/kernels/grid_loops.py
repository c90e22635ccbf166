"""Loops of the grid solvers that run once for many steps, and reconstructions of higher order.

Nodes have the indices 0..N, cells 0..N-1; cell i lies between nodes i and i+1.
"""

from hjprofile.solvers.kernels import compiled, vectorised

FLOOR_SHARE = 0.5  # largest distance of an edge value from its mean, as a fraction of 1 + q; it guarantees q > -1
NEGLIGIBLE = 1e-40  # differences of W or q that are replaced by 0
GHOSTS = 3  # cells beyond either end that reconstructions read


@compiled
def exponent(f, dx, E):
    """Fill E with ∫_x^0 f dξ at the nodes left of E[f.size], which is given, for values f on the cells."""
    for i in range(f.size - 1, -1, -1):
        E[i] = E[i + 1] + f[i] * dx


@compiled
def fastest(K, df):
    """Return the largest K f', with each cell's f' and the larger K of its two nodes."""
    speed = 0.0
    for i in range(df.size):
        speed = max(speed, max(K[i], K[i + 1]) * df[i])
    return speed


@compiled
def flat_ends(y, first, last, left, right):
    """Return `first` moved up and `last` moved down to the first values of y that differ from `left` and `right`.

    Values that differ by NEGLIGIBLE or less are replaced by `left` or `right`. Otherwise an exponential decay would end
    in denormal numbers.
    """
    while first < last and abs(y[first] - left) <= NEGLIGIBLE:
        y[first] = left
        first += 1
    while last > first and abs(y[last] - right) <= NEGLIGIBLE:
        y[last] = right
        last -= 1
    return first, last


@vectorised
def ghosts(padded):
    """Fill GHOSTS cells beyond either end by quadratic extrapolation, limited to twice the range of the last cells.

    The range is that of the last three cells. The limit is needed next to a kink, and inactive where q is smooth.
    """
    n = padded.size
    for side in range(2):
        at, inwards = (GHOSTS, 1) if side == 0 else (n - GHOSTS - 1, -1)
        a, b, c = padded[at], padded[at + inwards], padded[at + 2 * inwards]
        low, high = min(a, b, c), max(a, b, c)
        reach = 2.0 * (high - low)
        for k in range(1, GHOSTS + 1):
            value = a + k * (a - b) + 0.5 * k * (k + 1) * (a - 2.0 * b + c)
            padded[at - k * inwards] = min(max(value, low - reach), high + reach)


@vectorised
def edges_eno2(padded, edges):
    """Fill q on the left of the nodes 0..N by second-order ENO: the less steep of the lines to either neighbour."""
    for i in range(edges.size):
        q = padded[i + GHOSTS - 1]
        behind, ahead = q - padded[i + GHOSTS - 2], padded[i + GHOSTS] - q
        half = 0.5 * (behind if abs(behind) < abs(ahead) else ahead)
        most = FLOOR_SHARE * (1.0 + q)
        edges[i] = q + max(min(half, most), -most)


@vectorised
def edges_weno5(padded, edges):
    """Fill q on the left of the nodes 0..N by fifth-order WENO-Z (Borges et al., J. Comput. Phys. 227, 2008)."""
    for i in range(edges.size):
        a, b, q, c, d = padded[i], padded[i + 1], padded[i + 2], padded[i + 3], padded[i + 4]
        q0 = (2.0 * a - 7.0 * b + 11.0 * q) / 6.0
        q1 = (-b + 5.0 * q + 2.0 * c) / 6.0
        q2 = (2.0 * q + 5.0 * c - d) / 6.0
        s0 = 13.0 / 12.0 * (a - 2.0 * b + q) ** 2 + 0.25 * (a - 4.0 * b + 3.0 * q) ** 2
        s1 = 13.0 / 12.0 * (b - 2.0 * q + c) ** 2 + 0.25 * (b - c) ** 2
        s2 = 13.0 / 12.0 * (q - 2.0 * c + d) ** 2 + 0.25 * (3.0 * q - 4.0 * c + d) ** 2
        t = abs(s0 - s2)
        w0 = 0.1 * (1.0 + (t / (s0 + 1e-40)) ** 2)
        w1 = 0.6 * (1.0 + (t / (s1 + 1e-40)) ** 2)
        w2 = 0.3 * (1.0 + (t / (s2 + 1e-40)) ** 2)
        edge = (w0 * q0 + w1 * q1 + w2 * q2) / (w0 + w1 + w2)
        most = FLOOR_SHARE * (1.0 + q)
        edges[i] = q + max(min(edge - q, most), -most)


@vectorised
def exponent_from_nodes(f, dx, high_order, E):
    """Fill E with ∫_x^0 f dξ at the nodes 0..N for f at the nodes.

    The integral over a cell uses the trapezoidal rule, or six nodes (sixth order; five nodes in the two cells at each
    end).
    """
    n = f.size - 1
    E[n] = 0.0
    if high_order and n >= 6:
        for i in range(2, n - 2):
            inner, outer = f[i - 1] + f[i + 2], f[i - 2] + f[i + 3]
            E[i] = (802.0 * (f[i] + f[i + 1]) - 93.0 * inner + 11.0 * outer) * (dx / 1440.0)
        for k, inwards, first, second in ((0, 1, 0, 1), (n, -1, n - 1, n - 2)):
            a, b, c, d, e = f[k], f[k + inwards], f[k + 2 * inwards], f[k + 3 * inwards], f[k + 4 * inwards]
            E[first] = (251.0 * a + 646.0 * b - 264.0 * c + 106.0 * d - 19.0 * e) * (dx / 720.0)
            E[second] = (-19.0 * a + 346.0 * b + 456.0 * c - 74.0 * d + 11.0 * e) * (dx / 720.0)
    else:
        for i in range(n):
            E[i] = 0.5 * (f[i] + f[i + 1]) * dx
    for i in range(n - 1, -1, -1):
        E[i] += E[i + 1]
