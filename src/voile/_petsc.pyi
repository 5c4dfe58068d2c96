"""The compiled PETSc helpers of src/cpp/petsc_bindings.cpp. Its functions carry their own signatures."""

from typing import Any

def __getattr__(name: str) -> Any: ...
