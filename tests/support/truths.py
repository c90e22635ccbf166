"""The exact u of a problem as far as independent methods agree on it, and runs of `auto` that are judged by it.

Characteristics at their finest, extrapolated fronts, and extrapolated cells of the conservation law share no numerics.
The distance of two of them bounds the error of both, unless both err alike. Characteristics of the same problem in
other units (`twin`) have other panels and steps. The distance of the two is taken for the error if that to fronts is at
most COARSER times as large, because fronts cannot measure it.
"""

import multiprocessing
import time
import traceback
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from random_scenes import twin, twin_grid, unusual_scene

import hjprofile as hj
from hjprofile.solvers.methods import by_characteristics

TOLERANCES = 1e-2, 1e-3, 1e-5, 1e-7, 1e-9
AGREE = 0.1  # part of a tolerance within which two methods have to agree
RATIO = 0.73  # of lengths of the twin
COARSER = 1e4  # largest ratio of the distances to fronts and to the twin
FINE = 1e-13  # relative change by which an extrapolation is final
FEWEST_FRONTS, MOST_FRONTS = 200, 25600
FEWEST_CELLS, MOST_CELLS = 1000, 64000
SEEDS = 3  # first number of the seeds of unusual scenes


class Truth(NamedTuple):
    """u at the saved times and nodes; its distance from another method, and from the twin; which methods agree."""

    u: np.ndarray | None
    known: float
    by_twin: float
    methods: str

    @property
    def best(self):
        """The smaller of the two distances, the second only where other methods confirm it coarsely."""
        return min(self.known, max(self.by_twin, self.known / COARSER))


class Row(NamedTuple):
    """A run of `auto`: `error` and `estimate` are of u, `seconds` of the processor."""

    seed: int
    kind: str
    tolerance: float
    method: str
    error: float
    estimate: float
    seconds: float
    verdict: str  # one of VERDICTS
    known: float
    status: str


VERDICTS = "met", "silent miss", "unmet", "refused", "exception", "timeout", "not known"


def scene(seed):
    return unusual_scene(np.random.default_rng([SEEDS, seed]))


def truth(problem, grid, seconds=10.0, method_of=None):
    """Return the Truth. A method is refined until its last run took a quarter of `seconds` on the processor.

    `method_of(name)` returns u by one of METHODS, or None, and by default computes it.
    """
    method_of = method_of or (lambda name: METHODS[name](problem, grid, seconds))
    found = {name: u for name in ("characteristics", "fronts") if (u := method_of(name)) is not None}
    if len(found) == 1 and (u := method_of("cells")) is not None:
        found["cells"] = u
    names = list(found)
    apart = {(a, b): float(np.abs(found[a] - found[b]).max()) for i, a in enumerate(names) for b in names[i + 1 :]}
    if not apart:
        return Truth(None, np.inf, np.inf, " ".join(names))
    pair = min(apart, key=lambda names: apart[names])
    by_twin = np.inf
    if pair[0] == "characteristics" and (other := method_of("twin")) is not None:
        by_twin = float(np.abs(found[pair[0]] - other).max())
    return Truth(found[pair[0]], apart[pair], by_twin, " ".join(pair))


def _by_characteristics(problem, grid, seconds):
    for tolerance in (1e-12, 1e-10):
        try:
            run = by_characteristics(problem, grid, tolerance, patience=seconds)
        except (hj.RunError, ArithmeticError, ValueError):
            continue
        if run.done and np.isfinite(run.u).all():
            return run.u
    return None


def _by_twin(problem, grid, seconds):
    u = _by_characteristics(twin(problem, RATIO), twin_grid(grid, RATIO), seconds)
    return None if u is None else u / RATIO


def _by_fronts(problem, grid, seconds, most=MOST_FRONTS):
    return _extrapolated(
        lambda n: hj.track_fronts(problem, grid, n), FEWEST_FRONTS, most, 0.25 * seconds, lambda run: run.u
    )


def _by_cells(problem, grid, seconds):
    first = grid.cells * -(-FEWEST_CELLS // grid.cells)

    def solve(cells):
        run = hj.solve_conservative(problem, hj.Grid(grid.left, cells))
        if run.cautions:
            raise hj.RunError("not resolved")
        return run

    return _extrapolated(solve, first, MOST_CELLS, 0.25 * seconds, lambda run: run.u[:, :: run.cells // grid.cells])


def _extrapolated(solve, first, most, seconds, read):
    """Return u of second order extrapolated from the two finest runs, of numbers that double; None without two."""
    rows, found, n = [], [], first
    while n <= most:
        started = time.process_time()
        try:
            run = solve(n)
        except (hj.RunError, ArithmeticError, ValueError):
            run = None
        if run is not None and run.done and not run.cautions and np.isfinite(run.u).all():
            rows.append(read(run))
            if len(rows) > 1:
                found.append(rows[-1] + (rows[-1] - rows[-2]) / 3.0)
            if len(found) > 1 and np.abs(found[-1] - found[-2]).max() <= FINE * (1.0 + np.abs(found[-1]).max()):
                break
        if time.process_time() - started > seconds:
            break
        n *= 2
    return found[-1] if found else None


METHODS = {"characteristics": _by_characteristics, "fronts": _by_fronts, "cells": _by_cells, "twin": _by_twin}


def by_method(seed, name, seconds):
    """Return u of an unusual scene by one of METHODS, or None."""
    return METHODS[name](*scene(seed), seconds)


def known_truth(seed, folder=None, seconds=10.0, worker=None):
    """Return the Truth of an unusual scene, from a file of the folder if it is there, and kept there if not.

    A method that takes a worker more than four times `seconds` is left out.
    """
    problem, grid = scene(seed)
    path = Path(folder) / f"truth-{SEEDS}-{seed}.npz" if folder else None
    if path and path.exists():
        with np.load(path) as kept:
            if kept["title"] == problem.title and np.array_equal(kept["times"], problem.times):
                u = kept["u"] if kept["u"].size else None
                return Truth(u, float(kept["known"]), float(kept["by_twin"]), str(kept["methods"]))

    def method_of(name):
        if worker is None:
            return by_method(seed, name, seconds)
        try:
            return worker.call(by_method, seed, name, seconds, seconds=4.0 * seconds)
        except (TimeoutError, RuntimeError):
            return None

    found = truth(problem, grid, seconds, method_of)
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(
            path, u=np.empty(0) if found.u is None else found.u, known=found.known, by_twin=found.by_twin,
            methods=found.methods, title=problem.title, times=problem.times,
        )  # fmt: skip
    return found


def judged(seed, tolerance, exact):
    """Return the Row of `auto` on an unusual scene, judged by its Truth."""
    problem, grid = scene(seed)
    started = time.process_time()
    error = estimate = np.nan
    method = "-"
    try:
        run = hj.solve(problem, tolerance, grid)
    except hj.InputError as refusal:
        verdict, status = "refused", str(refusal)
    except hj.RunError as failure:
        verdict, status = "unmet", str(failure)
    except Exception as failure:  # that is what is looked for
        verdict, status = "exception", f"{type(failure).__name__}: {failure}\n{traceback.format_exc(limit=-3)}"
    else:
        method, status, estimate = run.method, run.status, float(run.error_estimate or np.nan)
        same = exact.u is not None and exact.u.shape == run.u.shape
        error = float(np.abs(run.u - exact.u).max()) if same else np.nan
        if not run.done:
            verdict = "unmet"
        elif error - exact.best > tolerance:
            verdict = "silent miss"
        else:
            verdict = "met" if exact.best <= AGREE * tolerance else "not known"
    seconds = time.process_time() - started
    return Row(
        seed, problem.title.partition(",")[0], tolerance, method, error, estimate, seconds, verdict, exact.best, status
    )


@cache
def compiled():
    """Compile what solves need, or read it from the cache, so that a forked process has it."""
    for law in (hj.rational(), hj.expression("2*q/(1+q)")):
        problem = hj.Problem(law, hj.bumps([1.0, -0.4], [-4.0, -2.0], [0.5, 0.5]), end=1.0)
        hj.solve(problem, 1e-3), hj.solve(problem, 1e-9), hj.solve_conservative(problem, hj.Grid(-6.0, 200))


class Worker:
    """A forked process in which functions of modules are called, and which is stopped where one takes too long."""

    def __init__(self):
        self.process = None

    def call(self, function, *arguments, seconds):
        """Return the function's value. Raises TimeoutError, and RuntimeError where the function raises."""
        if self.process is None:
            compiled()
            context = multiprocessing.get_context("fork")
            self.pipe, theirs = context.Pipe()
            self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
            self.process.start()
            theirs.close()
        self.pipe.send((function, arguments))
        if not self.pipe.poll(seconds):
            self.close()
            raise TimeoutError(f"{function.__name__} takes more than {seconds:g} s")
        try:
            value = self.pipe.recv()
        except EOFError:
            self.close()
            raise RuntimeError(f"the process of {function.__name__} ended") from None
        if isinstance(value, Exception):
            raise value
        return value

    def close(self):
        if self.process is not None:
            self.process.kill()
            self.process.join()
            self.process = None


def _serve(pipe):
    """Call what is asked for until the pipe closes."""
    np.seterr(all="ignore")  # as for a user, who may see warnings
    while True:
        try:
            function, arguments = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send(function(*arguments))
        except Exception as failure:
            pipe.send(RuntimeError(f"{type(failure).__name__}: {failure}"))


def study(seeds, tolerances=TOLERANCES, folder=None, limit=60.0, truth_seconds=10.0, most_timeouts=2):
    """Yield a Row for each seed and tolerance; each solve may take `limit` seconds.

    After `most_timeouts` of a scene its other tolerances are not tried.
    """
    worker = Worker()
    try:
        for seed in seeds:
            exact, left = known_truth(seed, folder, truth_seconds, worker), most_timeouts
            for tolerance in tolerances:
                try:
                    if not left:
                        raise TimeoutError("not tried after other timeouts")
                    yield worker.call(judged, seed, tolerance, exact, seconds=limit)
                except (TimeoutError, RuntimeError) as failure:
                    left = max(left - 1, 0)
                    kind = scene(seed)[0].title.partition(",")[0]
                    yield Row(
                        seed, kind, tolerance, "-", np.nan, np.nan, limit, "timeout", exact.best, str(failure)
                    )  # fmt: skip
    finally:
        worker.close()
