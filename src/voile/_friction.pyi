"""The compiled friction solver of src/cpp/friction_bindings.cpp. Its functions carry their own signatures."""

from typing import Any

def __getattr__(name: str) -> Any: ...
