"""`voile friction`: both layouts, what is stored, exit codes."""

import subprocess
import sys

import h5py
import numpy as np
import pytest
import scipy.sparse as sp

from voile.errors import InputError
from voile.results.friction import read_problem


def problem():
    rng = np.random.default_rng(5)
    B = rng.normal(size=(9, 5))
    return sp.csr_matrix(B @ B.T), B @ rng.normal(size=5), np.array([0.2, 0.5, 0.8])


def write_fclib(path, W, q, mu, kind=-2, spacedim=3):
    """As fclib_write_local does: kind is fclib_matrix.nz (-2 rows, -1 columns, otherwise triplets)."""
    with h5py.File(path, "w") as file:
        group = file.create_group("fclib_local")
        group["spacedim"] = np.array([spacedim], np.int32)
        if kind < 0:
            form = W.tocsr() if kind == -2 else W.tocsc()
            p, i, x = form.indptr, form.indices, form.data
        else:
            form = W.tocoo()
            p, i, x, kind = form.row, form.col, form.data, form.nnz
        for name, value in (("m", W.shape[0]), ("n", W.shape[1]), ("nz", kind), ("nzmax", len(x))):
            group[f"W/{name}"] = np.array([value], np.int32)
        group["W/p"], group["W/i"], group["W/x"] = p.astype(np.int32), i.astype(np.int32), x
        group["vectors/q"], group["vectors/mu"] = q, mu
        group["info/title"] = "a test"


def write_rows(path, W, q, mu):
    with h5py.File(path, "w") as file:
        for name in ("data", "indices", "indptr"):
            file[f"W/{name}"] = getattr(W, name)
        file["W/shape"], file["q"], file["mu"] = np.array(W.shape), q, mu


def voile(*args):
    command = [sys.executable, "-m", "voile.cli", "friction", *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.mark.parametrize("kind", [-2, -1, 0])
def test_fclib_round_trip(kind, tmp_path):
    W, q, mu = problem()
    W.data[3] += 1e-3  # unsymmetric: rows and columns must not be taken for each other
    write_fclib(tmp_path / "p.hdf5", W, q, mu, kind)
    read = read_problem(tmp_path / "p.hdf5")
    assert abs(read.W - W).max() == 0.0
    assert (read.q == q).all() and (read.mu == mu).all()


def test_both_layouts_give_the_same_solution(tmp_path):
    W, q, mu = problem()
    write_fclib(tmp_path / "a.hdf5", W, q, mu)
    write_rows(tmp_path / "b.h5", W, q, mu)
    reactions = []
    for name in ("a.hdf5", "b.h5"):
        done = voile(tmp_path / name, "-o", tmp_path / "out.h5")
        assert done.returncode == 0, done.stderr
        assert "3 contacts, error" in done.stdout and "stick" in done.stdout
        with h5py.File(tmp_path / "out.h5") as file:
            s = file["solution"]
            assert s.attrs["problem"] == str(tmp_path / name) and s.attrs["converged"]
            assert s.attrs["error"] <= 1e-8
            assert np.allclose(s["u"], W @ s["r"][:] + q, atol=1e-14)
            assert (s["mu"][:] == mu).all() and s["state"].shape == (3,)
            reactions.append(s["r"][:])
    assert (reactions[0] == reactions[1]).all()


def test_a_tolerance_is_met_and_costs(tmp_path, capsys):
    from voile.cli import main

    path, found, (W, q, mu) = tmp_path / "p.hdf5", [], problem()
    write_fclib(path, W, -q, mu)  # all come closer
    for tolerance in ("1e-1", "1e-12"):
        assert main(["friction", str(path), "-o", str(tmp_path / "out.h5"), "--tolerance", tolerance]) == 0
        with h5py.File(tmp_path / "out.h5") as file:
            found.append((file["solution"].attrs["error"], file["solution"].attrs["iterations"]))
    (rough, few), (fine, many) = found
    assert fine <= 1e-12 < rough <= 1e-1 and few < many
    for wrong in ("0", "nan"):
        assert main(["friction", str(path), "--tolerance", wrong]) == 2
        assert f"--tolerance {wrong}: allowed: a number > 0" in capsys.readouterr().err


def test_what_did_not_converge_is_kept(tmp_path):
    H = np.vstack([np.eye(3), -np.eye(3)])  # a body between two walls that come closer
    write_rows(tmp_path / "p.h5", sp.csr_matrix(H @ H.T), np.array([-1.0, 0, 0] * 2), np.array([0.3, 0.3]))
    done = voile(tmp_path / "p.h5", "-o", tmp_path / "out.h5")
    assert done.returncode == 3
    assert "grow without bound" in done.stderr and len(done.stderr.strip().splitlines()) == 1
    with h5py.File(tmp_path / "out.h5") as file:
        assert not file["solution"].attrs["converged"]
        assert np.isfinite(file["solution/r"]).all()


def damage(name, value):
    def change(path):
        with h5py.File(path, "r+") as file:
            del file[name]
            if value is not None:
                file[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (damage("fclib_local/vectors/q", None), "fclib_local/vectors/q is missing"),
        (damage("fclib_local/W/m", None), "fclib_local/W/m is missing"),
        (damage("fclib_local/spacedim", [2]), "spacedim is 2"),
        (damage("fclib_local/W/nz", [-7]), "W/nz is -7"),
        (damage("fclib_local/W/p", np.arange(4)), "W/p has 4 entries; 10 are needed"),
        (damage("fclib_local/W/i", np.full(81, 99)), "malformed problem"),
        (damage("fclib_local/vectors/mu", "none"), "must hold numbers"),
        (damage("fclib_local/vectors/mu", [0.1]), "q has 9 entries, mu 1"),
        (damage("fclib_local/vectors/mu", [0.1, -1.0, 0.2]), "must not be negative"),
        (damage("fclib_local/vectors/q", np.full(9, np.nan)), "is not finite"),
        (lambda path: path.write_text("no HDF5"), "not an HDF5 file"),
        (lambda path: path.unlink(), "no such file"),
    ],
)
def test_bad_files(change, message, tmp_path, capsys):
    from voile.cli import main

    path = tmp_path / "p.hdf5"
    write_fclib(path, *problem())
    change(path)
    assert main(["friction", str(path)]) == InputError.exit_code
    said = capsys.readouterr().err
    assert message in said and str(path) in said
    assert len(said.strip().splitlines()) == 1


def test_numbers_in_a_header_that_holds_none_are_refused(tmp_path):
    """HDF5 1.10 reads a compact dataset from its header, however little is there, and crashes (scripts/fuzz)."""
    path = tmp_path / "problem.h5"
    write_rows(path, *problem())
    with h5py.File(path, "a") as file:
        size = np.array([97, 89])
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_layout(h5py.h5d.COMPACT)
        del file["W/shape"]
        space = h5py.h5s.create_simple((2,))
        made = h5py.h5d.create(file["W"].id, b"shape", h5py.h5t.NATIVE_INT64, space, plist)
        made.write(h5py.h5s.ALL, h5py.h5s.ALL, size)
    stored = (16).to_bytes(2, "little") + size.tobytes()
    whole = path.read_bytes()
    assert whole.count(stored) == 1
    path.write_bytes(whole.replace(stored, bytes(2) + stored[2:]))
    run = [sys.executable, "-m", "voile.cli", "friction", str(path), "-o", str(tmp_path / "out.h5")]
    done = subprocess.run(run, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr


def test_equality_constraints_and_outputs_that_cannot_be(tmp_path, capsys):
    from voile.cli import main

    path = tmp_path / "p.hdf5"
    write_fclib(path, *problem())
    assert main(["friction", str(path), "-o", str(tmp_path / "none" / "out.h5")]) == 2
    assert "cannot be written" in capsys.readouterr().err
    with h5py.File(path, "r+") as file:
        file.create_group("fclib_local/V")
    assert main(["friction", str(path)]) == 2
    assert "equality constraints" in capsys.readouterr().err
