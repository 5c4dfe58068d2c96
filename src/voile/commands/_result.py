"""What the commands that read a result share."""

from pathlib import Path


def folder(result: Path) -> Path:
    """That of a result, which may be given by its file."""
    return result if result.is_dir() else result.parent
