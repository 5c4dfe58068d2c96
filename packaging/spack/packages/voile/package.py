# ruff: noqa: F403, F405 (Spack recipes are written so)
"""Voile for Spack.

spack repo add packaging/spack
spack install voile
Spack has no libigl, ipctk and ezdxf for Python (bodies as meshes, self-contact, patterns as DXF). After
`spack load voile`: `pip install --no-deps libigl ipctk ezdxf` into the environment that is loaded.
"""

import os
from pathlib import Path

from spack.package import *


class Voile(PythonPackage):
    """Equilibria and inverse design of thin elastic shells with contact and friction, on PETSc."""

    # the checkout that this file lies in, unless VOILE_GIT names another
    git = os.environ.get("VOILE_GIT", Path(__file__).resolve().parents[4].as_uri())

    license("BSD-2-Clause")
    version("main", branch="main")

    depends_on("c", type="build")
    depends_on("cxx", type="build")
    depends_on("cmake@3.20:", type="build")
    depends_on("ninja", type="build")
    depends_on("pkgconfig", type="build")
    depends_on("py-scikit-build-core@0.10:", type="build")
    depends_on("py-nanobind@2.4:", type="build")
    depends_on("python@3.11:", type=("build", "link", "run"))

    depends_on("mpi")
    depends_on("lapack")
    depends_on("suite-sparse")
    depends_on("petsc@3.18: +mpi+mumps+hypre~complex+double")
    depends_on("py-petsc4py@3.18:", type=("build", "run"))
    depends_on("py-slepc4py@3.18:", type=("build", "run"))
    depends_on("py-mpi4py", type=("build", "run"))
    depends_on("py-numpy", type=("build", "run"))
    depends_on("py-scipy", type="run")
    depends_on("py-h5py+mpi", type="run")
    depends_on("py-meshio", type="run")
    depends_on("py-shapely", type="run")

    def setup_build_environment(self, env):
        env.set("PETSC_DIR", self.spec["petsc"].prefix)
        env.unset("PETSC_ARCH")
