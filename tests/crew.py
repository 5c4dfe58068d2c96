"""Ranks that stay for a session of tests: each waits at a pipe of its own for what all run together.

To start two takes longer than most runs of theirs. `crew.py FOLDER`, under mpirun, is the ranks' side.
"""

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import command_line

GLANCE = 0.2  # s between looks at whether ranks that have not answered are still there
HOME = 5.0  # s for ranks that wait to end by themselves


class Crew:
    """Ranks started by `command` with `environment`, with pipes in an empty folder."""

    def __init__(self, command: Sequence[str], ranks: int, environment: Mapping[str, str], folder: Path):
        for name in (*map(str, range(ranks)), "answer"):
            os.mkfifo(folder / name)
        self.asked = [os.open(folder / str(rank), os.O_RDWR) for rank in range(ranks)]
        self.answer = os.fdopen(os.open(folder / "answer", os.O_RDWR))
        self.said = folder / "said"
        words = [*command, "-n", str(ranks), sys.executable, __file__, str(folder)]
        with open(self.said, "w") as said:
            self.process = subprocess.Popen(words, env=environment, stdout=said, stderr=subprocess.STDOUT)

    def run(self, kind: str, words: Sequence[object], timeout: float) -> subprocess.CompletedProcess[str]:
        """Words for a function of command_line ("voile", "script"), on all of them. After TimeoutExpired, or where a
        rank ended, the crew is no more."""
        line = json.dumps([kind, *map(str, words)]).encode() + b"\n"
        for pipe in self.asked:
            os.write(pipe, line)
        ends = time.monotonic() + timeout
        while not select.select([self.answer], [], [], GLANCE)[0]:
            late = time.monotonic() > ends
            if late or not self.there:
                self.end()
                if late:
                    raise subprocess.TimeoutExpired(line, timeout, self.said.read_bytes())
                return subprocess.CompletedProcess(
                    list(words), self.process.returncode, "", self.said.read_text()
                )
        return subprocess.CompletedProcess(list(words), *json.loads(self.answer.readline()))

    @property
    def there(self) -> bool:
        return self.process.poll() is None

    def end(self) -> None:
        """Ranks that wait go home, of others mpirun kills its own."""
        while self.asked:
            os.close(self.asked.pop())
        try:
            self.process.wait(HOME)
        except subprocess.TimeoutExpired:
            self.process.terminate()
            self.process.wait()


def serve(folder: Path) -> None:
    """Runs what is asked until whoever asks is gone."""
    from mpi4py import MPI

    world = MPI.COMM_WORLD
    with open(folder / str(world.rank)) as asked, open(folder / "answer", "w") as answer:
        for line in asked:
            kind, *words = json.loads(line)
            done = getattr(command_line, kind)(*words)
            ends = world.gather((done.returncode, done.stderr))
            if ends is not None:
                codes, said = zip(*ends, strict=True)
                print(json.dumps([max(codes), done.stdout, "".join(said)]), file=answer, flush=True)


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
