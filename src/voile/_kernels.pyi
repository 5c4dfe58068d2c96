"""The compiled kernels of src/cpp. Its functions carry their own signatures."""

from typing import Any

def __getattr__(name: str) -> Any: ...
