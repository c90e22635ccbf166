"""The recipe for an ensemble on a cluster: its members are those of a loop; a kill costs only chunks in progress."""

import contextlib
import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import hjprofile as hj

pytest.importorskip("distributed", reason="the extra cluster is not installed")
SCRIPT = Path(__file__).parents[1] / "docs" / "howto" / "cluster_ensemble.py"
COST = Path(__file__).parent / "benchmarks" / "cluster_cost.py"
CHUNKS, SIZE = 12, 25
TABLE = "toe_outflow", "crest_lowering", "eroded_volume", "length", "critical_slope"


needs_proc = pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc")


def module_of(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def recipe():
    return module_of(SCRIPT)


@pytest.fixture(scope="module")
def survey():
    return hj.read_survey(hj.shipped_cases()["hillslope"].with_name("hillslope.csv"))[:2]


def alone(recipe, survey, length, critical_slope):
    """Return the height on the ground and the scalars of one member: written here, without the script's functions."""
    slope = hj.survey(x=survey[0], height=survey[1], critical_slope=critical_slope, length=length, unit="m")
    run = hj.track_fronts(hj.Problem(hj.rational(), slope, 30840.0 / slope.units.volume, 2), fronts=400)
    area, rise = length**2 * critical_slope, length * critical_slope
    height = np.interp(recipe.GROUND, run.units.x(run.x), run.units.height(run.u[-1]))
    return height, (run.toe_outflow * area, (run.u[0, -1] - run.u[-1, -1]) * rise, run.eroded_volume * area)


def test_a_chunk_is_a_loop_over_its_members(recipe, survey, in_tmp):
    """The height bit for bit; the scalars to the rounding of heights up to 1021 m."""
    recipe.store_chunk("chunk.nc", hj.__version__, 3, 4, *survey)
    assert [path.name for path in in_tmp.iterdir()] == ["chunk.nc"]
    with xr.open_dataset("chunk.nc") as found:
        assert found.member.values.tolist() == [12, 13, 14, 15] and set(found.status.values) == {"done"}
        assert np.array_equal(found.distance.values, recipe.GROUND)
        for member in range(4):
            one = found.isel(member=member)
            height, scalars = alone(recipe, survey, one.length.item(), one.critical_slope.item())
            assert one.height.values.tobytes() == height.tobytes()
            assert [one[name].item() for name in TABLE[:3]] == pytest.approx(scalars, rel=1e-12)
            risen = height - np.interp(recipe.GROUND, *survey)
            # 400 points resolve the kinks to 0.1 % of the volume
            assert one.eroded_volume.item() == pytest.approx(-np.trapezoid(risen, recipe.GROUND), rel=2e-3)


def test_the_heights_are_accurate_to_a_decimetre(recipe, survey):
    """Against 4000 fronts, in members from both tails; in 40 members of the ensemble at most 0.071 m were measured."""
    for length, critical_slope in ((125.7, 0.263), (200.0, 0.257), (386.0, 0.279)):
        height, _ = recipe.solve_member(*survey, length, critical_slope)
        slope = hj.survey(x=survey[0], height=survey[1], critical_slope=critical_slope, length=length)
        run = hj.track_fronts(hj.Problem(hj.rational(), slope, 30840.0 / slope.units.volume, 2), fronts=4000)
        fine = np.interp(recipe.GROUND, run.units.x(run.x), run.units.height(run.u[-1]))
        assert np.abs(height - fine).max() < 0.1


def test_a_member_that_fails_is_a_row_with_its_reason(recipe, survey, monkeypatch):
    monkeypatch.setattr(recipe, "parameters", lambda chunk, size: (np.array([200.0, -1.0]), np.full(2, 0.257)))
    found = recipe.solve_chunk(0, 2, *survey)
    assert found.status.values[0] == "done" and "length = -1.0 must be a positive number" in found.status.values[1]
    for name in (*TABLE[:3], "height"):
        assert np.isnan(found[name].values[1]).all() and np.isfinite(found[name].values[0]).all()


def test_a_chunk_that_cannot_be_written_leaves_no_file(recipe, survey, in_tmp, monkeypatch):
    def half(self, path, **options):
        path.write_bytes(b"CDF\x01 half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", half)
    with pytest.raises(OSError, match="No space left"):
        recipe.store_chunk("chunk.nc", hj.__version__, 0, 1, *survey)
    with pytest.raises(RuntimeError, match=r"this worker has hjprofile .*, but the script has 0\.0"):
        recipe.store_chunk("chunk.nc", "0.0", 0, 1, *survey)
    assert list(in_tmp.iterdir()) == []


def test_members_and_names_do_not_depend_on_the_number_of_chunks(recipe, survey):
    """An ensemble can be extended; another survey, size or script has other names."""
    few, many = (recipe.files(Path(), chunks, 5, *survey) for chunks in (2, 3))
    assert few == many[:2] and len(set(many)) == 3
    assert recipe.files(Path(), 2, 6, *survey)[0] != few[0]
    assert recipe.files(Path(), 2, 5, survey[0], survey[1] + 1.0)[0] != few[0]
    lengths = np.concatenate([recipe.parameters(chunk, 500)[0] for chunk in range(4)])
    assert np.unique(lengths).size == 2000
    # four standard errors of 2000 normal numbers
    assert np.log(lengths / 200.0).std() == pytest.approx(np.log(1.4), rel=4 / np.sqrt(4000))


def test_the_comparison_of_two_ensembles_names_files_and_values(recipe, survey, in_tmp):
    """Equal folders give no line; a changed value, other bytes of equal values, and single files are named."""
    differences = module_of(COST).differences
    for folder in ("one", "two"):
        Path(folder).mkdir()
        recipe.store_chunk(f"{folder}/a.nc", hj.__version__, 0, 3, *survey)
    assert differences(Path("one"), Path("two")) == []
    with xr.open_dataset("one/a.nc") as stored:
        stored.load()
    chunk = stored.copy(deep=True)
    before = chunk.height.values[2, 7]
    chunk.height.values[2, 7:9] += [0.25, 0.125]  # exact, because heights are below 2**10
    chunk.status.values[1] = "lost"
    chunk.toe_outflow.values[0] = np.nan
    chunk.to_netcdf("two/a.nc", engine="scipy")
    Path("one/b.nc").write_bytes(b"")
    Path("two/c.part").write_bytes(b"CDF")
    assert differences(Path("one"), Path("two")) == [
        f"a.nc: 2 of 1200 values of height, by at most 0.25, first at [2, 7]: {before} and {before + 0.25}",
        "a.nc: 1 of 3 values of status, first at [1]: done and lost",
        f"a.nc: 1 of 3 values of toe_outflow, by at most nan, first at [0]: {stored.toe_outflow.values[0]} and nan",
        "b.nc: only in one",
        "c.part: only in two",
    ]
    chunk.to_netcdf("one/a.nc", engine="scipy")
    assert len(differences(Path("one"), Path("two"))) == 2  # NaN equals NaN
    chunk.assign_attrs(title="other").to_netcdf("one/a.nc", engine="scipy")
    assert differences(Path("one"), Path("two"))[0] == "a.nc: equal values in other bytes"
    Path("one/a.nc").write_bytes(b"CDF")
    assert differences(Path("one"), Path("two"))[0] == "a.nc: 3 bytes and " + (
        f"{Path('two/a.nc').stat().st_size} bytes, one of them unreadable"
    )


def children(pid):
    try:
        mine = [int(c) for c in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
        threads = [p for t in Path(f"/proc/{pid}/task").iterdir() for p in (t / "children").read_text().split()]
    except OSError:
        return []
    return sorted({*mine, *map(int, threads)})


def workers(pid):
    """Return the processes of the workers: those that were spawned, without the tracker of resources."""
    found = []
    for child in children(pid):
        with contextlib.suppress(OSError):  # it ended in between
            if "spawn_main" in Path(f"/proc/{child}/cmdline").read_text():
                found.append(child)
    return found


@contextlib.contextmanager
def started(command):
    """Start a script in a process group of its own, which is killed at the end, also if a test fails."""
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **streams, start_new_session=True) as running:
        try:
            yield running
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(running.pid, signal.SIGKILL)


def wait_for(condition, running):
    until = time.monotonic() + 120
    while not condition():
        assert running.poll() is None and time.monotonic() < until
        time.sleep(0.02)


@pytest.mark.slow  # half a minute: two clusters are started
@needs_proc
def test_killed_and_resumed_it_is_the_loop_bit_for_bit(recipe, survey, in_tmp):
    """The script is killed with all its processes; the second run loses a worker, and continues from the chunks."""
    arguments = ["out", f"--chunks={CHUNKS}", f"--size={SIZE}", "--workers=2"]
    command = [sys.executable, str(SCRIPT), *arguments]
    folder = Path("out")

    def stored():
        return sorted(folder.glob("*.nc"))

    with started(command) as running:
        wait_for(lambda: len(stored()) >= 2, running)
    before = {path: (path.stat().st_ino, path.read_bytes()) for path in stored()}
    assert 2 <= len(before) < CHUNKS - 2
    (folder / f"{CHUNKS - 1:05d}.part").write_bytes(b"CDF\x01 half")

    with started(command) as running:
        wait_for(lambda: len(stored()) > len(before), running)
        (folder / f"{CHUNKS - 1:05d}.again.part").write_bytes(b"CDF\x01 half")  # as of a worker killed while it writes
        lost = workers(running.pid)[0]
        os.kill(lost, signal.SIGKILL)
        out, err = running.communicate(timeout=120)
    assert running.returncode == 0, err
    assert f"{CHUNKS} chunks: {len(before)} from an earlier run, {CHUNKS - len(before)} solved now\n" in out
    assert f"{CHUNKS * SIZE} members, 0 failed\n" in out
    assert "Restarting worker" in err  # the kill found a worker at work
    assert {path: (path.stat().st_ino, path.read_bytes()) for path in before} == before  # not written again
    assert len(stored()) == CHUNKS == len(list(folder.iterdir()))

    for chunk, path in enumerate(stored()):
        again = in_tmp / path.name
        recipe.store_chunk(str(again), hj.__version__, chunk, SIZE, *survey)
        assert path.read_bytes() == again.read_bytes()
    with xr.open_mfdataset(stored(), combine="nested", concat_dim="member") as ensemble:
        assert np.array_equal(ensemble.member.values, np.arange(CHUNKS * SIZE))
        for member in (0, SIZE * CHUNKS // 2, SIZE * CHUNKS - 1):
            one = ensemble.isel(member=member).load()
            height, _ = alone(recipe, survey, one.length.item(), one.critical_slope.item())
            assert one.height.values.tobytes() == height.tobytes()

    done = subprocess.run([*command[:-2], f"--size={SIZE - 1}", command[-1]], capture_output=True, text=True)
    assert done.returncode == 1 and f"holds {CHUNKS} files of another ensemble; use another folder" in done.stderr


@pytest.mark.slow  # two minutes: the script waits a minute for workers
@needs_proc
def test_without_workers_it_stops_and_the_same_command_continues(recipe, survey, in_tmp):
    """dask does not replace a worker that is killed while it starts; without workers the script waits for a minute."""
    command = [sys.executable, str(SCRIPT), "out", "--chunks=6", "--size=25", "--workers=2"]
    folder = Path("out")
    with started(command) as running:
        wait_for(lambda: any(folder.glob("*.nc")), running)
        until = time.monotonic() + 20  # a worker starts within seconds
        while time.monotonic() < until:
            for worker in workers(running.pid):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(worker, signal.SIGKILL)
            time.sleep(0.02)
        solved = len(list(folder.glob("*.nc")))
        assert solved < 6 and not workers(running.pid)
        _, err = running.communicate(timeout=120)
    assert running.returncode == 1
    assert f"{6 - solved} chunks failed, the first with NoWorkerError" in err.splitlines()[-1]
    assert len(list(folder.iterdir())) == solved  # no part of a killed worker
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert f"6 chunks: {solved} from an earlier run, {6 - solved} solved now\n" in done.stdout
    for chunk, path in enumerate(sorted(folder.iterdir())):
        recipe.store_chunk("again.nc", hj.__version__, chunk, 25, *survey)
        assert path.read_bytes() == Path("again.nc").read_bytes()
