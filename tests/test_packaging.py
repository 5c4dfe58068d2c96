"""What installs the program elsewhere: wheel and sdist, recipes, job scripts."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from test_film import write

import voile
from voile.cli import main

ROOT = Path(__file__).parents[1]
PACKAGING = ROOT / "packaging"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
NEEDED = {re.match(r"[\w-]+", name)[0] for name in PROJECT["dependencies"]}
# a file beside the Python code -> one that would be missed
DATA = ("post/page/page.html", "post/page/viewer.js", "post/page/three.min.js", "post/page/three.LICENSE",
        "templates/drape/scene.toml", "templates/drape/sheet.obj")  # fmt: skip


@pytest.mark.parametrize("path", sorted(PACKAGING.glob("slurm/*")), ids=lambda p: p.name)
def test_job_scripts_are_scripts(path):
    subprocess.run(["bash", "-n", path], check=True)
    assert os.access(path, os.X_OK)


def test_recipes_name_what_is_needed():
    """Each dependency is in the recipe, or named there as one to come from pip."""
    spack = (PACKAGING / "spack/packages/voile/package.py").read_text()
    conda = (PACKAGING / "conda/recipe.yaml").read_text()
    compile(spack, "package.py", "exec")
    by_pip = {recipe: set(re.search(r"pip install --no-deps ([\w -]+?)[`' ]*(into|$)", recipe, re.M)[1].split())
              for recipe in (spack, conda)}  # fmt: skip
    for name in NEEDED:
        assert f'"py-{name}' in spack or name in by_pip[spack], name
        assert (
            re.search(rf"^    - {'igl' if name == 'libigl' else name}\b", conda, re.M)
            or name in by_pip[conda]
        ), name
    assert f"version: {voile.__version__}\n" in conda
    for recipe in ("Dockerfile", "voile.def"):
        assert "scripts/setup" in (PACKAGING / recipe).read_text()


def test_recipes_ask_for_the_projects_versions():
    """pyproject.toml and CMakeLists.txt say from which version on; both recipes ask for the same."""
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    least = dict(re.fullmatch(r"([\w-]+)>=([\d.]+)", name).groups() for name in build)
    least["python"] = PROJECT["requires-python"].removeprefix(">=")
    least["cmake"] = re.search(
        r"cmake_minimum_required\(VERSION ([\d.]+)", (ROOT / "CMakeLists.txt").read_text()
    )[1]
    spack = (PACKAGING / "spack/packages/voile/package.py").read_text()
    conda = (PACKAGING / "conda/recipe.yaml").read_text()
    for name, version in least.items():
        asked = re.findall(rf'depends_on\("(?:py-)?{name}@([\d.]+):"', spack)
        assert asked == [version], f"Spack: {name} {version}, not {asked}"
        asked = re.findall(rf"^    - {name}\b *(.*)$", conda, re.M)
        assert asked and set(asked) == {f">={version}"}, f"conda: {name} {version}, not {asked}"


def test_conda_specs_are_specs():
    """A name, then at most a version and a build between blanks: `version=build` is none where the build has a star."""
    conda = (PACKAGING / "conda/recipe.yaml").read_text()
    listed = re.findall(
        r"^    - ([^$\n]+)$", conda[conda.index("requirements:") : conda.index("tests:")], re.M
    )
    assert len(listed) > 15
    for spec in listed:
        assert re.fullmatch(r"[a-z\d-]+( (>=)?[\d.*]+( [\w*]+)?| \* [\w*]+)?", spec), spec


# what stands in for the cluster and the study: tasks run at once, one after the other
SBATCH = r"""#!/usr/bin/env bash
echo "sbatch $*" >> "$LOG"
while (($#)); do
  case $1 in
    --array=1-*) count=${1#--array=1-} ;;
    --wrap) bash -c "$2" ; shift ;;
    --*) ;;
    *) for ((k = 1; k <= count; k++)); do SLURM_ARRAY_TASK_ID=$k bash "$@" >&2; done; break ;;
  esac
  shift
done
echo 42
"""
VOILE = r"""#!/usr/bin/env bash
echo "voile $*" >> "$LOG"
if [[ " $* " == *" --list-runs "* ]]; then
  for ((k = 1; k <= ${RUNS:-3}; k++)); do echo "voile study 'a study.toml' -o out --run $k"; done
fi
"""


def submit(folder, *arguments, **environment):
    for name, text in (
        ("sbatch", SBATCH),
        ("voile", VOILE),
        ("srun", '#!/usr/bin/env bash\necho srun >> "$LOG"\n'),
    ):
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    env = {**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "LOG": str(folder / "log"), **environment}
    done = subprocess.run(
        [PACKAGING / "slurm/submit-study", *arguments],
        cwd=folder,
        env=env,
        capture_output=True,
        text=True,
        timeout=60,
    )
    log = (folder / "log").read_text().splitlines() if (folder / "log").exists() else []
    return done, log


def test_a_study_is_an_array(tmp_path):
    """A task per missing run, then the tables after all of them, with the caller's options."""
    done, log = submit(tmp_path, "a study.toml", "out", "--time=0:10:00", SLURM_NTASKS="4")
    assert done.returncode == 0, done.stderr
    assert done.stdout == "3 runs: job 42\ntables: job 42\n"
    assert log[0] == "voile study a study.toml -o out --list-runs"
    assert "--array=1-3" in log[1] and "--time=0:10:00" in log[1]
    assert log[2:5] == [f"voile study a study.toml -o out --run {k}" for k in (1, 2, 3)]
    assert "--dependency=afterany:42" in log[5] and log[6] == "voile study a study.toml -o out"


def test_a_complete_study_has_no_array(tmp_path):
    done, log = submit(tmp_path, "a study.toml", "out", RUNS="0")
    assert done.returncode == 0 and done.stdout == "tables: job 42\n"
    assert not any("--array" in line for line in log)
    done, log = submit(tmp_path, "a study.toml")
    assert done.returncode == 2 and "submit-study STUDY.toml OUT" in done.stderr


@pytest.mark.parametrize(("command", "module"), [("report", "matplotlib"), ("render", "pyvista")])
def test_a_plain_install_says_what_it_lacks(tmp_path, monkeypatch, capsys, command, module):
    write(tmp_path, [0.0, 0.5])
    monkeypatch.setitem(sys.modules, module, None)
    assert main([command, str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"voile: needs {module}: pip install 'voile[pictures]'\n"


@pytest.mark.slow
def test_sdist_and_wheel(tmp_path):
    """The sdist builds the wheel, and that runs in an environment of its own, beside the system's PETSc only."""
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}

    def call(*command, **more):
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=3000, **more)
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
        return done.stdout

    call(sys.executable, "-m", "build", "--no-isolation", "--outdir", tmp_path / "dist", ROOT)
    (sdist,), (wheel,) = (tmp_path / "dist").glob("*.tar.gz"), (tmp_path / "dist").glob("*.whl")
    with tarfile.open(sdist) as file:
        names = {name.split("/", 1)[1] for name in file.getnames() if "/" in name}
    assert {f"src/voile/{name}" for name in DATA} <= names and not any("-result/" in name for name in names)
    with zipfile.ZipFile(wheel) as file:
        names = set(file.namelist())
    assert {f"voile/{name}" for name in DATA} <= names
    assert sdist.stat().st_size < 20e6 and wheel.stat().st_size < 20e6
    call("/usr/bin/python3", "-m", "venv", "--system-site-packages", tmp_path / "clean")
    clean = tmp_path / "clean" / "bin"
    script = "import numpy, scipy; print(f'numpy=={numpy.__version__}\\nscipy=={scipy.__version__}')"
    (tmp_path / "constraints").write_text(call(clean / "python", "-c", script))
    call(clean / "python", "-m", "pip", "-q", "install", "-c", tmp_path / "constraints", wheel)
    work = tmp_path / "work"
    work.mkdir()
    call(clean / "voile", "new", "cloth", "--template", "drape", cwd=work)
    call(clean / "voile", "run", "cloth/scene.toml", "-o", "result", cwd=work)
    assert "converged" in call(clean / "voile", "info", "result", cwd=work)
    call(clean / "voile", "export", "result", "--to", "obj", cwd=work)
    assert (work / "result" / "shape.obj").is_file()
    where = call(clean / "python", "-c", "import voile; print(voile.__file__)", cwd=work)
    assert where.startswith(str(tmp_path / "clean"))
