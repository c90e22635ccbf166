"""The equation solved with three general packages, each set up as an expert would, to time them against hjprofile.

q_t + (K f(q))_x = 0 on [left, 0], f = q/(1+q), K = exp ∫_x^0 f dξ; or, with W = u - x and q = W_x, W_t + K f(W_x) = 0.
All speeds K f' are positive, so one-sided differences are upwind and exact at both ends (q = 0 left of the support).
None of the packages knows a nonlocal factor: each peer feeds K in where the package lets a user do so.
"""

import ctypes
from collections.abc import Callable
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np


class Scene(NamedTuple):
    """An initial state on [left, 0], W = u - x at the nodes, to be carried to time `end`."""

    name: str
    left: float
    end: float
    W: Callable[[np.ndarray], np.ndarray]


class Peer(NamedTuple):
    """`prepare(scene, cells)` compiles and sets up; what it returns does the time stepping, to the cell means of q."""

    name: str
    prepare: Callable[[Scene, int], Callable[[], np.ndarray]]


def _start(scene: Scene, cells: int) -> tuple[float, np.ndarray, np.ndarray]:
    """dx, W at the nodes and the exact cell means of q, at t = 0."""
    nodes = scene.left * (np.arange(cells, -1, -1) / cells)
    W = np.asarray(scene.W(nodes), dtype=float)
    dx = -scene.left / cells
    return dx, W, np.diff(W) / dx


def _steps(scene: Scene, dx: float, q: np.ndarray, courant: float) -> int:
    """Number of equal steps by the speeds K f' at t = 0: f' falls along characteristics, so these last the run."""
    K = np.exp(dx * np.cumsum((q / (1 + q))[::-1])[::-1])
    return int(np.ceil(scene.end * np.max(K / (1 + q) ** 2) / (courant * dx)))


# --- PyClaw: wave propagation, with the Riemann solver and the update of K compiled by numba


@lru_cache
def _pyclaw_kernels() -> tuple:
    """The Riemann solver, with Fortran's arguments, and the update of K in the auxiliary array."""
    import numba as nb
    from numba import types

    integers, reals = types.CPointer(types.int32), types.CPointer(types.float64)

    @nb.cfunc(types.void(*[integers] * 6, *[reals] * 8), error_model="numpy")
    def riemann(_maxmx, _meqn, _mwaves, _maux, ghosts, cells, ql, qr, auxl, auxr, fwave, s, amdq, apdq):
        n = cells[0] + 2 * ghosts[0]
        for i in range(1, n):
            a, b = qr[i - 1], ql[i]
            fwave[i] = auxl[i] * (b / (1 + b)) - auxr[i - 1] * (a / (1 + a))
            s[i] = 0.5 * (auxl[i] + auxr[i - 1]) / ((1 + a) * (1 + b))  # [f]/[q]
            amdq[i] = 0.0
            apdq[i] = fwave[i]

    @nb.njit(error_model="numpy")
    def update_K(q, K, dt, dx, ghosts, order):
        """K at the end of each cell; at second order at its middle and at t + dt/2, without which it is first order."""
        n = q.size - ghosts
        K[:] = q  # and at second order q half an upwind step later
        if order == 2:
            right, outflow = 1.0, 0.0
            for i in range(n - 1, -1, -1):
                f = q[i] / (1 + q[i])
                middle = np.exp(0.5 * dx * f)
                inflow = right * middle * f
                K[i + 1] -= 0.5 * dt / dx * (outflow - inflow)
                right, outflow = right * middle * middle, inflow
            K[0] -= 0.5 * dt / dx * outflow
        right = 1.0
        for i in range(n - 1, -1, -1):
            middle = np.exp(0.5 * dx * K[i] / (1 + K[i]))
            K[i] = right * middle if order == 2 else right
            right *= middle * middle
        K[n:] = K[n - 1]

    return riemann, update_K


def _pyclaw(order: int, courant: float, scene: Scene, cells: int) -> Callable[[], np.ndarray]:
    import logging

    from clawpack import pyclaw

    dx, _, q0 = _start(scene, cells)
    riemann, update_K = _pyclaw_kernels()
    capsule = ctypes.pythonapi.PyCapsule_New
    capsule.restype, capsule.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]

    logging.getLogger().setLevel(logging.WARNING)  # importing it sends every package's chatter to the terminal
    solver = pyclaw.ClawSolver1D()
    solver.rp = SimpleNamespace(rp1=SimpleNamespace(_cpointer=capsule(riemann.address, None, None)))
    solver.num_eqn, solver.num_waves, solver.fwave = 1, 1, True
    solver.order, solver.limiters = order, pyclaw.limiters.tvd.MC
    solver.cfl_desired, solver.cfl_max, solver.max_steps = courant, 1.0, 10**9
    solver.bc_lower[0] = solver.bc_upper[0] = pyclaw.BC.extrap
    # the one hook that runs after the step size is chosen, where K at the half step can be known
    solver.aux_bc_lower[0] = solver.aux_bc_upper[0] = pyclaw.BC.custom
    solver.user_aux_bc_lower = lambda state, dim, t, qbc, auxbc, ghosts: None
    solver.user_aux_bc_upper = lambda state, dim, t, qbc, auxbc, ghosts: update_K(
        qbc[0], auxbc[0], solver.dt, dx, ghosts, order
    )

    domain = pyclaw.Domain(pyclaw.Dimension(scene.left, 0.0, cells, name="x"))
    state = pyclaw.State(domain, 1, 1)
    state.aux[:] = 1.0
    solution = pyclaw.Solution(state, domain)
    first = scene.end / _steps(scene, dx, q0, courant)

    def run() -> np.ndarray:
        state.q = np.asfortranarray(q0[np.newaxis])
        solution.t, solver.dt, solver.dt_old = 0.0, first, None
        solver.evolve_to_time(solution, scene.end)
        return state.q[0].copy()

    run()
    return run


# --- hj_reachability: its gradients, Hamiltonian and time loop; K rides along as a second component of the states


def _hj_reachability(scheme: str, courant: float, scene: Scene, cells: int) -> Callable[[], np.ndarray]:
    import jax

    jax.config.update("jax_enable_x64", True)
    import hj_reachability as hj
    import jax.numpy as jnp
    from hj_reachability.artificial_dissipation import local_local_lax_friedrichs
    from hj_reachability.time_integration import euler_step

    dx, W0, _ = _start(scene, cells)
    gradient = getattr(hj.finite_differences.upwind_first, scheme)

    def upwind(values, spacing, boundary):
        """Its left gradient on both sides: the package's Lax-Friedrichs Hamiltonian then is the Godunov one."""
        left = gradient(values, spacing, boundary)[0]
        return left, left

    class Erosion:
        """The part of the package's Dynamics that its solver calls: there is nothing to control."""

        def hamiltonian(self, state, time, value, grad_value):
            return state[1] * grad_value[0] / (1 + grad_value[0])

        def partial_max_magnitudes(self, state, time, value, grad_value_box):
            return state[1:] / (1 + grad_value_box.lo) ** 2

    def stage(settings, dynamics, grid, time, values, *step):
        q = jnp.diff(values) / dx
        K = jnp.exp(dx * jnp.cumsum((q / (1 + q))[::-1])[::-1])
        states = jnp.stack([grid.states[:, 0], jnp.append(K, 1.0)], -1)
        return euler_step(settings, dynamics, grid.replace(states=states), time, values, *step)

    def integrator(settings, dynamics, grid, time, values, target):
        """Euler, or the package's third-order TVD Runge-Kutta, with K renewed at every stage."""
        end, one = stage(settings, dynamics, grid, time, values, None, target - time)
        if scheme == "first_order":
            return end, one
        two = stage(settings, dynamics, grid, end, one, end - time)[1]
        half = 0.75 * values + 0.25 * two
        return end, values / 3 + 2 / 3 * stage(settings, dynamics, grid, time, half, end - time)[1]

    settings = hj.SolverSettings(
        upwind_scheme=upwind,
        artificial_dissipation_scheme=local_local_lax_friedrichs,
        time_integrator=integrator,
        CFL_number=courant,
    )
    grid = hj.Grid.from_lattice_parameters_and_boundary_conditions(
        hj.sets.Box(np.array([scene.left]), np.array([0.0])), (cells + 1,), (hj.boundary_conditions.extrapolate,)
    )
    dynamics, initial = Erosion(), jnp.asarray(W0)

    def run() -> np.ndarray:
        W = hj.step(settings, dynamics, grid, 0.0, initial, scene.end, progress_bar=False)
        return np.diff(np.asarray(W)) / dx

    run()
    return run


# --- py-pde: the right-hand side written for its numba backend, its own time steppers


def _py_pde(order: int, courant: float, scene: Scene, cells: int) -> Callable[[], np.ndarray]:
    import pde
    from pde.solvers import EulerSolver, RungeKuttaSolver

    dx, _, q0 = _start(scene, cells)

    def rate(q, t=0):
        """-(K f)_x, from the right; at second order with the monotonized central slope of every cell."""
        n = q.size
        change, total, outflow = np.empty_like(q), 0.0, 0.0
        for i in range(n - 1, -1, -1):
            edge = q[i]
            if order == 2:
                back = q[i] - q[i - 1] if i > 0 else 0.0
                ahead = q[i + 1] - q[i] if i < n - 1 else back
                if back * ahead > 0:
                    edge += 0.5 * np.sign(back) * min(2 * abs(back), 2 * abs(ahead), 0.5 * abs(back + ahead))
            flux = np.exp(total) * edge / (1 + edge)
            if i < n - 1:
                change[i + 1] = (flux - outflow) / dx
            outflow = flux
            total += dx * q[i] / (1 + q[i])
        change[0] = -outflow / dx
        return change

    class Erosion(pde.PDEBase):
        def evolution_rate(self, state, t=0):
            raise NotImplementedError

        def make_evolution_rate(self, state, backend):
            return rate

    field = pde.ScalarField(pde.CartesianGrid([[scene.left, 0.0]], cells), q0)
    solver = (EulerSolver if order == 1 else RungeKuttaSolver)(Erosion(), backend="numba")
    stepper = solver.make_stepper(field, dt=scene.end / _steps(scene, dx, q0, courant))

    def run() -> np.ndarray:
        field.data[:] = q0
        stepper(field, 0.0, scene.end)
        return field.data.copy()

    run()
    return run


# at the Courant number that was best of a few for each
PEERS: dict[str, Peer] = {
    peer.name: peer
    for peer in (
        Peer("PyClaw, 1st order", partial(_pyclaw, 1, 0.98)),
        Peer("PyClaw, 2nd order, K at half step", partial(_pyclaw, 2, 0.9)),
        Peer("hj_reachability 1st order", partial(_hj_reachability, "first_order", 0.98)),
        Peer("hj_reachability WENO5", partial(_hj_reachability, "WENO5", 1.1)),
        Peer("py-pde upwind", partial(_py_pde, 1, 0.98)),
        Peer("py-pde 2nd order upwind, Runge-Kutta", partial(_py_pde, 2, 1.2)),
    )
}
