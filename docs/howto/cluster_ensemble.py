"""Run an ensemble of a surveyed hillslope on a dask cluster, in chunks that are stored as they are solved.

    python cluster_ensemble.py FOLDER --chunks 100 --size 100 --workers 2
    python cluster_ensemble.py FOLDER --chunks 200 --size 500 --scheduler tcp://HOST:8786

The same command continues a run that was stopped. The folder must be on a file system that all machines share.
"""

import argparse
import hashlib
import os
import uuid
from pathlib import Path

import dask
import numpy as np
import xarray as xr
from distributed import Client, as_completed

import hjprofile as hj

SEED = 5
SUPPLIED = 30840.0  # volume per metre of width, in m²
GROUND = np.linspace(0.0, 2536.09, 400)  # metres, from the toe of the survey to its crest
FRONTS = 400
SCALARS = "toe_outflow", "crest_lowering", "eroded_volume"  # m², m, m²


def parameters(chunk, size):
    """Return the exchange lengths and the neutral slopes of a chunk; other chunks do not change them."""
    normal = np.random.default_rng([SEED, chunk]).standard_normal((2, size))
    return 200.0 * 1.4 ** normal[0], 0.257 + 0.01 * normal[1]


def solve_member(x, height, length, critical_slope):
    """Return the height on the ground at the end, and the scalars, in metres."""
    slope = hj.survey(x=x, height=height, critical_slope=critical_slope, length=length, unit="m")
    units = slope.units
    problem = hj.Problem(hj.rational(), slope, SUPPLIED / units.volume, snapshots=2)
    run = hj.track_fronts(problem, fronts=FRONTS)
    if not run.done:
        raise hj.RunError(run.status)
    before, after = (np.interp(GROUND, units.x(run.x), units.height(u)) for u in run.u)
    return after, (run.toe_outflow * units.volume, before[-1] - after[-1], run.eroded_volume * units.volume)


def solve_chunk(chunk, size, x, height):
    """Return the results of a chunk. A member that fails has its reason as status, and NaN."""
    heights, scalars = np.full((size, GROUND.size), np.nan), np.full((len(SCALARS), size), np.nan)
    status = np.full(size, "done", dtype=object)
    lengths, slopes = parameters(chunk, size)
    for i in range(size):
        try:
            heights[i], scalars[:, i] = solve_member(x, height, lengths[i], slopes[i])
        except (hj.InputError, hj.RunError) as error:
            status[i] = str(error)
    columns = dict(zip(SCALARS, scalars, strict=True)) | {"length": lengths, "critical_slope": slopes, "status": status}
    return xr.Dataset(
        {name: ("member", values) for name, values in columns.items()} | {"height": (("member", "distance"), heights)},
        coords={"member": np.arange(chunk * size, (chunk + 1) * size), "distance": GROUND},
    )


def store_chunk(path, version, *task):
    """Solve a chunk and write its file, completely or not at all."""
    if hj.__version__ != version:
        raise RuntimeError(f"this worker has hjprofile {hj.__version__}, but the script has {version}")
    part = Path(path).with_suffix(f".{uuid.uuid4().hex}.part")
    try:
        solve_chunk(*task).to_netcdf(part, engine="scipy")
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        part.replace(path)  # a file of this name is complete
    finally:
        part.unlink(missing_ok=True)


def files(folder, chunks, size, x, height):
    """Return the path of each chunk. Its name changes with this script, the survey, the size and the version."""
    content = Path(__file__).read_bytes(), x.tobytes(), height.tobytes(), f"{size} {hj.__version__}".encode()
    key = hashlib.sha256(b"\0".join(content)).hexdigest()[:12]
    return [folder / f"chunk-{chunk:05d}-{key}.nc" for chunk in range(chunks)]


def solve(client, paths, size, x, height):
    """Solve the chunks that have no file. Return their number, and the errors of those that failed."""
    todo = {chunk: path for chunk, path in enumerate(paths) if not path.exists()}
    # a task is sent again if its worker is lost, and twice more if it raises, as on a full disk
    futures = [
        client.submit(store_chunk, str(path), hj.__version__, chunk, size, x, height, pure=False, retries=2)
        for chunk, path in todo.items()
    ]
    errors = []
    for future in as_completed(futures):
        if future.status != "finished":
            errors.append(f"{type(future.exception()).__name__}: {future.exception()}")
        future.release()
    return len(todo), errors


def remove_parts(folder):
    """Remove the unfinished files of workers that were killed."""
    for part in folder.glob("*.part"):
        part.unlink(missing_ok=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=lambda text: Path(text).resolve())
    parser.add_argument("--chunks", type=int, default=100)
    parser.add_argument("--size", type=int, default=100, help="members of a chunk")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=int, default=os.cpu_count(), help="on this machine")
    where.add_argument("--scheduler", help="address of a running cluster")
    options = parser.parse_args()

    x, height, _ = hj.read_survey(hj.shipped_cases()["hillslope"].with_name("hillslope.csv"))
    options.folder.mkdir(parents=True, exist_ok=True)
    paths = files(options.folder, options.chunks, options.size, x, height)
    if others := set(options.folder.glob("*.nc")) - set(paths):
        raise SystemExit(f"{options.folder} holds {len(others)} files of another ensemble; use another folder")
    remove_parts(options.folder)
    solve_member(x, height, 200.0, 0.257)  # compiles the loops once; the workers of this machine load them
    # dask does not replace a local worker that is killed while it starts; without workers a task fails after a minute
    dask.config.set({"distributed.scheduler.no-workers-timeout": "60s"})
    here = {"n_workers": options.workers, "threads_per_worker": 1, "dashboard_address": None}
    with Client(options.scheduler) if options.scheduler else Client(**here) as client:
        solved, errors = solve(client, paths, options.size, x, height)
    remove_parts(options.folder)
    print(f"{len(paths)} chunks: {len(paths) - solved} from an earlier run, {solved - len(errors)} solved now")
    if errors:
        raise SystemExit(f"{len(errors)} chunks failed, the first with {errors[0]}; the same command tries them again")
    with xr.open_mfdataset(paths, engine="scipy", combine="nested", concat_dim="member") as ensemble:
        done = (ensemble.status == "done").values
        low, median, high = np.quantile(ensemble.crest_lowering.values[done], [0.05, 0.5, 0.95])
    print(f"{done.size} members, {done.size - done.sum()} failed")
    print(f"the crest falls by {median:.1f} m; 90 %: {low:.1f} to {high:.1f} m")


if __name__ == "__main__":
    main()
