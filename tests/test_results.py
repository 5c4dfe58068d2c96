"""The result file: the same from any number of ranks, readable by others, whole after any kill."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from mpi4py import MPI

from voile.errors import InputError
from voile.results import (
    Body,
    ResultWriter,
    StaticMesh,
    prepare_output,
    read_result,
    read_summary,
    write_summary,
)

SIDE = 6
X, Y = np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 2, SIDE))
START = np.column_stack([X.ravel(), Y.ravel(), 0 * X.ravel()])
CORNER = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
TRIANGLES = np.concatenate(
    [
        np.column_stack([CORNER, CORNER + 1, CORNER + SIDE + 1]),
        np.column_stack([CORNER, CORNER + SIDE + 1, CORNER + SIDE]),
    ]
)
EDGES = np.unique(np.sort(TRIANGLES[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
GROUP = (np.arange(len(TRIANGLES)) % 2).astype(np.int32)
BODIES = (
    Body("plane 0", 0.3, 1.0 + START[:3], np.array([[0, 1, 2]])),
    Body("kühl", 0.0, -START[:4], TRIANGLES[:0]),
)
SCENE = '[scene]\nname = "Tüll"\n'


def state(step):
    """Every stored array of a step, made up from its global index so that a misplaced row shows."""
    n, m, e = len(START), len(TRIANGLES), len(EDGES)
    return {
        "value": 0.1 * step,
        "points": START + np.array([0, 0, step + 1]),
        "reaction": np.arange(3 * n).reshape(n, 3) + 100.0 * step,
        "contact": (np.arange(n) + step) % 3,
        "energy_density": np.arange(m) + 0.5 * step,
        "edge_angles": np.arange(e) - 1e3 * step,
        "placements": np.arange(32.0).reshape(2, 4, 4) - step,
    }


def write(path, comm, steps, pause=0.0, first=0, close=True, **options):
    """Write `steps` steps, the global rows dealt to the ranks at random."""
    deal = np.random.default_rng(1)
    mine = [deal.permutation(len(a))[comm.rank :: comm.size] for a in (START, TRIANGLES, EDGES)]
    mesh = StaticMesh(
        START, TRIANGLES, edges=EDGES, group=GROUP, group_names=("front", "back"), bodies=BODIES
    )
    writer = ResultWriter(
        path,
        comm,
        mesh=mesh if comm.rank == 0 else None,
        scene_text=SCENE,
        versions={"voile": "0.1"},
        **options,
    )
    for step in range(first, first + steps):
        s = state(step)
        writer.write_step(
            s["value"],
            s["points"][mine[0]],
            mine[0],
            point_data={"reaction": s["reaction"][mine[0]], "contact": s["contact"][mine[0]]},
            cell_data={"energy_density": s["energy_density"][mine[1]]},
            cell_index=mine[1],
            edge_angles=s["edge_angles"][mine[2]],
            edge_index=mine[2],
            scalars={"newton_iterations": step},
            placements=s["placements"],
        )
        time.sleep(pause)
    if close:
        writer.close()
    return writer


def check(result, steps):
    """The file holds exactly `steps` steps and each is exact to the last bit."""
    assert result.n_steps == steps and len(result.values) == steps
    assert np.array_equal(result.triangles, TRIANGLES) and np.array_equal(result.edges, EDGES)
    assert np.array_equal(result.start, START) and np.array_equal(result.rest, START)
    assert np.array_equal(result.field("group"), GROUP) and result.group_names == ("front", "back")
    for body, read in zip(BODIES, result.bodies, strict=True):
        assert (read.name, read.friction) == (body.name, body.friction)
        assert np.array_equal(read.points, body.points) and np.array_equal(read.triangles, body.triangles)
    for step in range(steps):
        s = state(step)
        assert np.array_equal(result.placements(step), s["placements"])
        assert result.values[step] == s["value"]
        assert np.array_equal(result.points(step), s["points"])
        assert np.array_equal(result.edge_angles(step), s["edge_angles"])
        for name in ("reaction", "contact", "energy_density"):
            assert np.array_equal(result.field(name, step), s[name]), name
        assert result.scalars(step) == {"newton_iterations": step}


def test_room_is_taken_for_all_that_a_larger_file_holds(tmp_path, monkeypatch):
    """HDF5 does not survive a full disk: what a copy with room for twice the steps takes was there before."""
    from voile.results import writer

    path, taken, rebuild = tmp_path / "result.vtkhdf", [], ResultWriter._rebuild
    reserve = writer.reserve
    monkeypatch.setattr(writer, "reserve", lambda part, size: (taken.append(size), reserve(part, size)))

    def rebuilt(self, capacity):
        rebuild(self, capacity)
        assert os.stat(path).st_blocks * 512 <= taken[-1]

    monkeypatch.setattr(ResultWriter, "_rebuild", rebuilt)
    write(path, MPI.COMM_SELF, 260)
    assert len(taken) > 5


@pytest.mark.parametrize("steps", [1, 16, 17, 40])
def test_round_trip(tmp_path, steps):
    path = tmp_path / "result.vtkhdf"
    write(path, MPI.COMM_SELF, steps)
    with read_result(tmp_path) as result:
        check(result, steps)
        assert result.scene_text == SCENE and result.versions == {"voile": "0.1"}
        assert result.unit("reaction") == "N"
        restart = result.restart()
        assert restart.value == result.values[-1] and set(restart.point_data) == {"reaction", "contact"}
        assert np.array_equal(restart.points, result.points(steps - 1))
        with pytest.raises(IndexError, match=f"there are {steps}"):
            result.points(steps)
        with pytest.raises(KeyError, match="reaction"):
            result.field("velocity")
    assert os.listdir(tmp_path) == ["result.vtkhdf"]


@pytest.mark.mpi
@pytest.mark.parametrize("gather", ["0", "1"])
@pytest.mark.parametrize("ranks", [1, 2, pytest.param(4, marks=pytest.mark.slow)])
def test_same_file_on_any_number_of_ranks(tmp_path, script_on, ranks, gather):
    said = script_on(ranks, __file__, tmp_path / "result.vtkhdf", "20", f"VOILE_GATHER={gather}")
    shown = dict(word.split("=") for word in said.split())
    able = shown["h5py.mpi"] == "True"  # Debian's; PyPI's is built without MPI
    assert shown["parallel"] == str(able and ranks > 1 and gather == "0")
    with read_result(tmp_path) as result:
        check(result, 20)


def test_vtk_reads_every_step(tmp_path):
    """Closed and killed files alike: VTK's reader, which ParaView and PyVista use."""
    closed, open_end = tmp_path / "closed.vtkhdf", tmp_path / "open.vtkhdf"
    write(closed, MPI.COMM_SELF, 20)
    write(open_end, MPI.COMM_SELF, 20, close=False)
    for path in (closed, open_end):
        times, _ = read_with_vtk(path, 0)
        assert times == [state(s)["value"] for s in range(20)]
        for step in (0, 7, 19):
            _, grid = read_with_vtk(path, step)
            assert np.array_equal(grid.points, state(step)["points"])
            assert np.array_equal(grid.cells_dict[5], TRIANGLES)
            assert np.array_equal(grid["reaction"], state(step)["reaction"])
            assert np.array_equal(grid["energy_density"], state(step)["energy_density"])
            assert np.array_equal(grid["rest"], START)


def read_with_vtk(path, step):
    pyvista = pytest.importorskip("pyvista")
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    reader.UpdateTimeStep(times[step])
    return list(times), pyvista.wrap(reader.GetOutputDataObject(0))


def test_killed_runs_keep_their_last_complete_step(tmp_path):
    """SIGKILL at moments spread over a run, through several rebuilds of the file; the last ones late enough for a
    slow machine."""
    seen = []
    for attempt in range(9):
        path = tmp_path / f"{attempt}.vtkhdf"
        child = subprocess.Popen([sys.executable, __file__, str(path), "100000"], stdout=subprocess.DEVNULL)
        deadline = time.monotonic() + 30
        while not path.exists() and time.monotonic() < deadline:
            time.sleep(0.002)
        time.sleep(0.022 * attempt if attempt < 4 else 0.1 * 2.0 ** (attempt - 4))
        child.send_signal(signal.SIGKILL)
        child.wait()
        with read_result(path) as result:
            check(result, result.n_steps)
            seen.append(result.n_steps)
        if attempt > 4 and max(seen) > 16:
            break
    assert max(seen) > 16, f"no run was killed after a rebuild: {seen}"


@pytest.mark.mpi
@pytest.mark.parametrize("seconds", [*(pytest.param(s, marks=pytest.mark.slow) for s in (0.05, 0.13)), 0.4])
def test_killed_parallel_runs_keep_their_last_complete_step(tmp_path, mpirun, seconds):
    path = tmp_path / "result.vtkhdf"
    done = mpirun(2, [sys.executable, __file__, str(path), "100000", str(seconds)], 60)
    assert done.returncode != 0 and "parallel" not in done.stdout
    with read_result(path) as result:
        check(result, result.n_steps)


def test_truncated_foreign_missing(tmp_path):
    path = tmp_path / "result.vtkhdf"
    write(path, MPI.COMM_SELF, 3)
    whole = path.read_bytes()
    for size in (0, 1, 7, 8, 100, 2048, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(InputError, match="damaged result file|not a result file") as caught:
            read_result(path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    import h5py

    with h5py.File(path, "w") as file:
        file["x"] = 1
    with pytest.raises(InputError, match="lacks the group"):
        read_result(path)
    path.unlink()
    with pytest.raises(InputError, match="no such result file"):
        read_result(path)


def test_newer_format_is_refused(tmp_path):
    import h5py

    path = tmp_path / "result.vtkhdf"
    write(path, MPI.COMM_SELF, 1)
    with h5py.File(path, "r+") as file:
        file["voile"].attrs["format_version"] = 99
    with pytest.raises(InputError, match="result format 99; this program reads up to 1"):
        read_result(path)


def test_previous_result_is_kept(tmp_path):
    path = tmp_path / "result.vtkhdf"
    write(path, MPI.COMM_SELF, 2)
    write_summary(tmp_path / "summary.json", {"converged": True})
    ResultWriter(path, MPI.COMM_SELF, mesh=StaticMesh(START, TRIANGLES)).close()
    with read_result(path) as result:  # a run that computed nothing has replaced nothing
        check(result, 2)
    write(path, MPI.COMM_SELF, 5)
    with read_result(path) as result, read_result(tmp_path / "result.previous.vtkhdf") as previous:
        check(result, 5)
        check(previous, 2)
    assert read_summary(tmp_path / "summary.previous.json") == {"converged": True}
    assert not (tmp_path / "summary.json").exists()


def test_rest_shape_with_its_own_vertices(tmp_path):
    corners = np.arange(3 * len(TRIANGLES)).reshape(-1, 3)
    rest = START[TRIANGLES].reshape(-1, 3) * 2
    mesh = StaticMesh(START, TRIANGLES, rest=rest, rest_triangles=corners)
    with ResultWriter(tmp_path / "result.vtkhdf", MPI.COMM_SELF, mesh=mesh) as writer:
        writer.write_step(1.0, START, np.arange(len(START)))
    with read_result(tmp_path) as result:
        assert np.array_equal(result.rest, rest) and np.array_equal(result.rest_triangles, corners)
        assert np.array_equal(result.field("rest"), 2 * START)
        assert result.edges is None and result.edge_angles() is None and result.scalars() == {}
    with pytest.raises(ValueError, match="rest_triangles must say"):
        ResultWriter(tmp_path / "x", MPI.COMM_SELF, mesh=StaticMesh(START, TRIANGLES, rest=rest))


def test_wrong_use_is_told(tmp_path):
    everyone = np.arange(len(START))

    def writer():
        return ResultWriter(tmp_path / "r.vtkhdf", MPI.COMM_SELF, mesh=StaticMesh(START, TRIANGLES))

    with pytest.raises(ValueError, match="no field 'velocty'.*velocity"):
        writer().write_step(0, START, everyone, point_data={"velocty": START})
    with pytest.raises(ValueError, match="exactly one rank"):
        writer().write_step(0, START, np.zeros_like(everyone))
    with pytest.raises(ValueError, match="outside 0..35"):
        writer().write_step(0, START, everyone + 1)
    some = writer()
    some.write_step(0, START, everyone, point_data={"velocity": START})
    with pytest.raises(ValueError, match="velocity"):
        some.write_step(1, START, everyone)
    some.close()


def test_prepare_output(tmp_path):
    new = tmp_path / "a" / "b"
    assert prepare_output(new, MPI.COMM_SELF) == new and os.listdir(new) == []
    (tmp_path / "file").write_text("")
    for bad in (tmp_path / "file", tmp_path / "file" / "below", "/proc/voile"):
        with pytest.raises(InputError, match="writable directory expected") as caught:
            prepare_output(bad, MPI.COMM_SELF)
        assert str(bad) in str(caught.value)


def test_summary(tmp_path):
    path = tmp_path / "summary.json"
    summary = {
        "converged": np.bool_(True),
        "dofs": np.int64(3),
        "energy": {"bending": np.float64(0.5)},
        "n": np.arange(2),
    }
    write_summary(path, summary)
    assert read_summary(path) == {"converged": True, "dofs": 3, "energy": {"bending": 0.5}, "n": [0, 1]}
    for bad in (float("nan"), np.float64("inf"), np.array([1.0, -np.inf])):
        with pytest.raises(ValueError, match="energy.bending"):
            write_summary(path, {"energy": {"bending": bad}})
    assert json.loads(path.read_text())["dofs"] == 3 and os.listdir(tmp_path) == ["summary.json"]
    path.write_text("{")
    with pytest.raises(InputError, match="not a JSON summary"):
        read_summary(path)
    with pytest.raises(InputError, match="cannot read the summary"):
        read_summary(tmp_path / "none.json")


def kill_self(path, seconds):
    """SIGKILL to this process that long after the result has appeared."""
    while not path.exists():
        time.sleep(0.002)
    time.sleep(seconds)
    os.kill(os.getpid(), signal.SIGKILL)


def test_an_error_in_the_first_step_is_the_one_that_is_raised(tmp_path):
    mesh = StaticMesh(START, TRIANGLES)
    with (
        pytest.raises(ValueError) as caught,
        ResultWriter(tmp_path / "result.vtkhdf", MPI.COMM_SELF, mesh=mesh) as writer,
    ):
        writer.write_step(1.0, START[:-1], np.arange(len(START) - 1))
    assert not isinstance(caught.value, OSError)
    assert not (tmp_path / "result.vtkhdf").exists()


if __name__ == "__main__":
    changes = dict(word.split("=") for word in sys.argv[3:] if "=" in word)
    if sys.argv[3:] and not changes:
        threading.Thread(target=kill_self, args=(Path(sys.argv[1]), float(sys.argv[3])), daemon=True).start()
    with mock.patch.dict(os.environ, changes):
        made = write(sys.argv[1], MPI.COMM_WORLD, int(sys.argv[2]))
    if MPI.COMM_WORLD.rank == 0:
        import h5py

        print(f"parallel={made.parallel} h5py.mpi={h5py.get_config().mpi}")
