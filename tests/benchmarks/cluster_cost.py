"""Measures the recipe docs/howto/cluster_ensemble.py with 10,000 members on two local workers.

    python tests/benchmarks/cluster_cost.py [CHUNKS] [SIZE]

It prints the numbers of docs/howto/ensemble_on_a_cluster.md. It needs the extra `cluster` and a system with /proc.
"""

import importlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import xarray as xr
from distributed import Client

import hjprofile as hj

SCRIPT = Path(__file__).parents[2] / "docs" / "howto" / "cluster_ensemble.py"
TASKS = 2000
LOOP = 200  # members of one loop
REPEATS = 5


def recipe():
    """Return the script as a module that workers can import, because they have the path of this process."""
    sys.path.insert(0, str(SCRIPT.parent))
    return importlib.import_module(SCRIPT.stem)


def seconds_of(function):
    """Return wall and processor seconds of a call."""
    wall, cpu = time.perf_counter(), time.process_time()
    function()
    return time.perf_counter() - wall, time.process_time() - cpu


def loop(ensemble, survey):
    """Print and return seconds per member in a plain loop, wall and processor; print those of a file."""
    lengths, slopes = ensemble.parameters(0, LOOP)
    ensemble.solve_member(*survey, 200.0, 0.257)  # loads the compiled loops

    def members():
        for length, slope in zip(lengths, slopes, strict=True):
            ensemble.solve_member(*survey, length, slope)

    wall, cpu = np.median([seconds_of(members) for _ in range(REPEATS)], axis=0) / LOOP
    print(f"loop: {1e3 * wall:.2f} ms per member, {1e3 * cpu:.2f} ms of processor time", flush=True)
    return wall, cpu


def file_of_a_chunk(ensemble, survey, size):
    """Print seconds to write the file of a chunk."""
    found = ensemble.solve_chunk(0, size, *survey)
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{i}.nc" for i in range(REPEATS + 1)]
        written = [seconds_of(lambda path=path: found.to_netcdf(path, engine="scipy"))[0] for path in paths]
    print(f"file of {size} members: {1e3 * np.median(written[1:]):.1f} ms", flush=True)


def scheduler(ensemble, survey):
    """Print seconds per empty task, and seconds until a killed worker is replaced and has solved its first member."""
    with Client(n_workers=2, threads_per_worker=1, dashboard_address=None) as client:
        client.gather(client.map(lambda i: i, range(10), pure=False))
        each = [seconds_of(lambda: client.gather(client.map(lambda i: i, range(TASKS), pure=False)))[0] for _ in "abc"]
        print(f"scheduler: {1e3 * np.median(each) / TASKS:.2f} ms per empty task", flush=True)
        pids = client.run(os.getpid)
        address, pid = next(iter(pids.items()))
        os.kill(pid, signal.SIGKILL)
        start = time.perf_counter()
        while address in (known := client.scheduler_info(n_workers=-1)["workers"]) or len(known) < 2:
            time.sleep(0.05)
        replaced = time.perf_counter() - start
        (new,) = set(known) - set(pids)
        client.submit(ensemble.solve_member, *survey, 200.0, 0.257, workers=[new], pure=False).result(timeout=120)
        print(f"killed worker: replaced after {replaced:.1f} s, first member after {time.perf_counter() - start:.1f} s")


def command(folder, chunks, size):
    return [sys.executable, str(SCRIPT), str(folder), f"--chunks={chunks}", f"--size={size}", "--workers=2"]


def whole(folder, chunks, size):
    """Run the script once. Print and return wall seconds and those of all processors, per member."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    wall = seconds_of(lambda: subprocess.run(command(folder, chunks, size), check=True))[0]
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    files = list(folder.iterdir())
    print(f"ensemble: {chunks * size} members, {wall:.1f} s, {cpu:.1f} s of processor time")
    print(f"files: {len(files)}, {sum(file.stat().st_size for file in files) / 1e6:.1f} MB", flush=True)
    return wall, cpu


LOOPS = """
import sys
sys.path.insert(0, sys.argv[1])
import cluster_ensemble as ensemble, hjprofile as hj
x, height, _ = hj.read_survey(hj.shipped_cases()["hillslope"].with_name("hillslope.csv"))
ensemble.solve_member(x, height, 200.0, 0.257)
for chunk in range(int(sys.argv[2]), int(sys.argv[3]), 2):
    ensemble.solve_chunk(chunk, int(sys.argv[4]), x, height)
"""


def processor_seconds(commands):
    """Run commands at the same time. Return the processor seconds of them and of their processes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    for running in [subprocess.Popen(command, stdout=subprocess.DEVNULL) for command in commands]:
        assert running.wait() == 0
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def marginal(size=100, few=2, many=32, repeats=3):
    """Print processor time per member of the recipe and of two loops in two processes, in turn; without their starts.

    Other programs change the processor time of a member, so only runs that take turns can be compared.
    """
    costs = {"recipe": [], "loops": []}
    starts = []
    for _ in range(repeats):
        taken = {}
        for chunks in (few, many):
            with tempfile.TemporaryDirectory() as folder:
                taken["recipe", chunks] = processor_seconds([command(folder, chunks, size)])
            start = [sys.executable, "-c", LOOPS, str(SCRIPT.parent)]
            loops = [[*start, str(first), str(chunks), str(size)] for first in (0, 1)]
            taken["loops", chunks] = processor_seconds(loops)
        for name, found in costs.items():
            found.append((taken[name, many] - taken[name, few]) / ((many - few) * size))
        starts.append(taken["recipe", few] - few * size * costs["recipe"][-1])
    for name, found in costs.items():
        print(f"{name}: {', '.join(f'{1e3 * cost:.2f}' for cost in found)} ms of processor time per member", flush=True)
    print(f"start of the recipe: {', '.join(f'{start:.1f}' for start in starts)} s of processor time", flush=True)


def stopped(folder, chunks, size):
    """Kill the script at 40 % of the chunks, and one worker of the second run. Print the wall seconds of both."""

    def until(running, fraction):
        while len(list(folder.glob("*.nc"))) < fraction * chunks:
            assert running.poll() is None
            time.sleep(0.05)

    start = time.perf_counter()
    with subprocess.Popen(command(folder, chunks, size), start_new_session=True) as running:
        until(running, 0.4)
        os.killpg(running.pid, signal.SIGKILL)
    first, start = time.perf_counter() - start, time.perf_counter()
    with subprocess.Popen(command(folder, chunks, size)) as running:
        until(running, 0.7)
        threads = Path(f"/proc/{running.pid}/task").iterdir()
        children = [pid for thread in threads for pid in (thread / "children").read_text().split()]
        workers = [pid for pid in children if "spawn_main" in Path(f"/proc/{pid}/cmdline").read_text()]
        os.kill(int(workers[0]), signal.SIGKILL)
        assert running.wait() == 0
    print(f"stopped and resumed: {first:.1f} s and {time.perf_counter() - start:.1f} s", flush=True)


def values_that_differ(chunks):
    """Return a line for each variable of two chunks whose values differ: their number, the largest difference, one."""
    lines = []
    for name in sorted(set(chunks[0].variables) ^ set(chunks[1].variables)):
        lines.append(f"{name} is in one of them only")
    for name in [name for name in chunks[0].variables if name in chunks[1].variables]:
        one, other = (chunk[name].values for chunk in chunks)
        if one.shape != other.shape:
            lines.append(f"{name} has the shapes {one.shape} and {other.shape}")
            continue
        number = np.issubdtype(one.dtype, np.number) and np.issubdtype(other.dtype, np.number)
        differ = (one != other) & ~(np.isnan(one) & np.isnan(other)) if number else one != other
        if differ.any():
            most = f", by at most {np.abs(one - other)[differ].max()}" if number else ""
            first = tuple(np.argwhere(differ)[0].tolist())
            at = f"first at {list(first)}: {one[first]} and {other[first]}"
            lines.append(f"{differ.sum()} of {differ.size} values of {name}{most}, {at}")
    return lines or ["equal values in other bytes"]


def differences(*folders):
    """Return the differences of two folders of chunks, file by file and value by value, as lines."""
    lines = []
    for name in sorted({path.name for folder in folders for path in folder.iterdir()}):
        paths = [folder / name for folder in folders]
        if len(found := [path for path in paths if path.exists()]) == 1:
            lines.append(f"{name}: only in {found[0].parent}")
        elif paths[0].read_bytes() != paths[1].read_bytes():
            try:
                chunks = [xr.load_dataset(path, engine="scipy") for path in paths]
            except Exception:  # a damaged file raises any of several types
                sizes = " and ".join(f"{path.stat().st_size} bytes" for path in paths)
                lines.append(f"{name}: {sizes}, one of them unreadable")
            else:
                lines.extend(f"{name}: {line}" for line in values_that_differ(chunks))
    return lines


def main(chunks=100, size=100):
    ensemble = recipe()
    survey = hj.read_survey(hj.shipped_cases()["hillslope"].with_name("hillslope.csv"))[:2]
    print(f"load of the machine before: {os.getloadavg()[0]:.1f}, {os.cpu_count()} processors", flush=True)
    alone_wall, alone_cpu = loop(ensemble, survey)
    file_of_a_chunk(ensemble, survey, size)
    scheduler(ensemble, survey)
    marginal()
    folders = [Path(tempfile.mkdtemp()) for _ in range(2)]
    wall, cpu = whole(folders[0], chunks, size)
    members = chunks * size
    print(f"overhead per member: {1e3 * (2.0 * wall / members - alone_wall):.2f} ms of two workers' wall time,")
    print(f"                     {1e3 * (cpu / members - alone_cpu):.2f} ms of processor time")
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")
    stopped(folders[1], chunks, size)
    different = differences(*folders)
    print(
        f"resumed ensemble: {len(list(folders[1].iterdir()))} files, {len(different)} differences", *different, sep="\n"
    )
    if different:
        raise SystemExit(1)  # the folders remain for a closer look
    for folder in folders:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
