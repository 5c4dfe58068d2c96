"""C++ of Projective Dynamics, src/cpp/projective_bindings.cpp. Its functions carry their own signatures."""

from typing import Any

def __getattr__(name: str) -> Any: ...
