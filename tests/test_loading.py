"""What a command loads: start and imports are a third of a short run."""

import subprocess
import sys

from test_cli import SCENE, cells


def test_commands_load_what_they_need_when_they_run():
    """The command line alone takes 50 ms; with numpy it took 150."""
    loaded = "import sys, voile.cli; voile.cli._parser(); print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    assert "voile.commands.section" in modules.stdout.split() and "numpy" not in modules.stdout.split()


def test_runs_load_what_their_scene_needs(tmp_path):
    """Libraries for layers, meshes as obstacles and modes take 25 ms of the 340 that a short run takes."""
    (tmp_path / "mesh.obj").write_text(cells())
    (tmp_path / "scene.toml").write_text(SCENE)

    def loaded(words: str) -> set[str]:
        code = f"import sys, {words}; print(*sys.modules)"
        run = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
        )
        return set(run.stdout.split())

    modules = loaded("voile.cli; voile.cli.main(['run', 'scene.toml'])")
    assert "voile.solver.statics" in modules
    modules -= loaded("scipy.sparse")  # newer ones need numpy.typing
    assert not {"igl", "ipctk", "numpy.typing", "slepc4py.SLEPc", "voile.commands.section"} & modules
