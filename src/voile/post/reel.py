"""Film files: pictures one after the other as mp4, gif or webp, each drawn when its turn comes."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import IO

import numpy as np
from PIL import Image

from voile.arrays import Ints
from voile.errors import InputError
from voile.files import replacing

Draw = Callable[[int], Ints]  # (height, width, 3) uint8 of a frame
Tell = Callable[[int, int], None] | None  # told how many frames are drawn of how many
GIF_FASTEST = 50.0  # 1/s: viewers slow down gif frames of less than 20 ms
CRF, WEBP_QUALITY = "18", 85  # text has clean edges: H.264's constant quality (0 without loss to 51), of 100
FORMATS = (".mp4", ".gif", ".webp")


def check_film(out: Path, fps: float) -> None:
    """InputError for a name or a number of frames per second (fps) that no film can have."""
    if out.suffix.lower() not in FORMATS:
        raise InputError(f"{out}: unknown format {out.suffix!r}; allowed for films: {', '.join(FORMATS)}")
    if not 0 < fps < np.inf:
        raise InputError(f"fps = {fps:g}: frames per second above 0 expected")
    if out.suffix.lower() == ".gif" and fps > GIF_FASTEST:
        raise InputError(
            f"{out}: fps = {fps:g}; allowed for gif: at most {GIF_FASTEST:g}, for mp4 and webp more"
        )


def write_film(
    out: Path, draw: Draw, count: int, fps: float, size: tuple[int, int], on_frame: Tell = None
) -> None:
    """Writes `count` frames of width, height (pixels), fps of them a second. The file appears when it is complete.

    Raises InputError where it cannot be written, before anything is drawn.
    """
    with replacing(out) as file:
        _WRITERS[out.suffix.lower()](file, _told(draw, count, on_frame), count, fps, size)


def _told(draw: Draw, count: int, on_frame: Tell) -> Draw:
    """Draws, and tells of frames not drawn before."""
    done: set[int] = set()

    def drawn(frame: int) -> Ints:
        done.add(frame)
        if on_frame:
            on_frame(len(done), count)
        return draw(frame)

    return drawn


def _write_mp4(file: IO[bytes], draw: Draw, count: int, fps: float, size: tuple[int, int]) -> None:
    """H.264 with one colour for four pixels, which every player shows."""
    import av

    if size[0] % 2 or size[1] % 2:
        raise InputError(f"{size[0]} x {size[1]} pixels: films as mp4 have even numbers of them")
    # the index first: a browser shows it while it loads
    with av.open(file.name, "w", format="mp4", options={"movflags": "faststart"}) as film:
        stream = film.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000), options={"crf": CRF})
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        for k in range(count):
            film.mux(stream.encode(av.VideoFrame.from_ndarray(draw(k), format="rgb24")))
        film.mux(stream.encode())


def _write_gif(file: IO[bytes], draw: Draw, count: int, fps: float, size: tuple[int, int]) -> None:
    """One palette, of the first, middle and last frame, so that still parts do not flicker."""
    some = np.concatenate([draw(k) for k in sorted({0, count // 2, count - 1})])
    palette = Image.fromarray(some).quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    ends = np.round(100 * np.arange(count + 1) / fps)  # gif counts in hundredths
    reel = _Reel(
        lambda k: Image.fromarray(draw(k)).quantize(palette=palette, dither=Image.Dither.NONE), count
    )
    reel.save(file, "gif", save_all=True, duration=(10 * np.diff(ends)).astype(int).tolist(), loop=0)


def _write_webp(file: IO[bytes], draw: Draw, count: int, fps: float, size: tuple[int, int]) -> None:
    ends = np.round(1000 * np.arange(count + 1) / fps)
    reel = _Reel(lambda k: Image.fromarray(draw(k)), count)
    reel.save(
        file, "webp", save_all=True, duration=np.diff(ends).astype(int).tolist(), loop=0, quality=WEBP_QUALITY
    )


_WRITERS = {".mp4": _write_mp4, ".gif": _write_gif, ".webp": _write_webp}


class _Reel(Image.Image):
    """A film as Pillow sees one that it opens: `seek` brings a frame. So no more than one is in memory."""

    def __init__(self, draw: Callable[[int], Image.Image], count: int):
        super().__init__()
        self._draw, self.n_frames, self._at = draw, count, -1
        self.seek(0)

    def seek(self, frame: int) -> None:
        if frame >= self.n_frames:
            raise EOFError
        if frame == self._at:
            return
        picture, self._at = self._draw(frame), frame
        self.im, self._mode, self._size, self.palette = (
            picture.im,
            picture.mode,
            picture.size,
            picture.palette,
        )

    def tell(self) -> int:
        return self._at
