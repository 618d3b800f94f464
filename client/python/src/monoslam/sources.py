"""Where frames come from: a folder, a camera, or anything that yields `Frame`."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

from .errors import FrameError
from .images import ImageLike
from .model import Camera, CameraModel

_IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".webp", ".tif", ".tiff", ".pgm", ".ppm"}


@dataclass(frozen=True, eq=False)
class Frame:
    """An image and when it was taken."""

    image: ImageLike
    """Pixels, the bytes of an image file, or its path, which is read when it is sent."""
    timestamp_ns: int = field(default_factory=time.time_ns)
    """Strictly increasing within a session. Left out: now."""
    channels: str = "rgb"
    """The order of colors of an array; "bgr" for OpenCV's."""


@dataclass(frozen=True)
class Folder:
    """A recording: `rgb.txt` with `timestamp filename` in each line, seconds, and `calib.json`. Iterate for
    frames."""

    path: Path
    camera: Camera
    times_ns: tuple[int, ...]
    files: tuple[Path, ...]

    @staticmethod
    def open(path: str | PathLike[str]) -> Folder:
        """Raises FrameError if a file is missing or cannot be understood."""
        folder = Path(path)
        try:
            camera = _read_calibration(folder / "calib.json")
            # Editors of some systems begin a file with a mark of the byte order.
            lines = (folder / "rgb.txt").read_text(encoding="utf-8-sig").splitlines()
            rows = [_row(line) for line in lines if line.strip() and not line.startswith("#")]
            times = tuple(nanoseconds(row[0]) for row in rows)
            files = tuple(_listed(folder, row[1]) for row in rows)
        except OSError as error:
            raise FrameError(f"{error.filename}: {error.strerror}") from error
        except (ValueError, KeyError, IndexError) as error:
            raise FrameError(f"{folder}: calib.json or rgb.txt cannot be understood: {error!r}") from error
        return Folder(folder, camera, times, files)

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, rows: slice) -> Folder:
        return Folder(self.path, self.camera, self.times_ns[rows], self.files[rows])

    def __iter__(self) -> Iterator[Frame]:
        return (Frame(file, t) for file, t in zip(self.files, self.times_ns, strict=True))


class Capture(Protocol):
    """What `cv2.VideoCapture` is."""

    def read(self) -> tuple[bool, Any]: ...


def captures(capture: Capture, *, fps: float | None = None) -> Iterator[Frame]:
    """Frames of a cv2.VideoCapture until it ends, at the times they are read; with `fps`, as for a video
    file, at even times from 0."""
    n_read = 0
    while True:
        is_read, image = capture.read()
        if not is_read:
            return
        timestamp_ns = time.time_ns() if fps is None else round(n_read * 1e9 / fps)
        # OpenCV may write its next image over this one.
        yield Frame(image.copy(), timestamp_ns, "bgr")
        n_read += 1


def image_files(folder: str | PathLike[str], fps: float) -> Iterator[Frame]:
    """The image files of a folder in the order of their names, at even times; 10 comes after 9."""
    files = [file for file in Path(folder).iterdir() if file.suffix.lower() in _IMAGE_SUFFIXES]
    files.sort(key=lambda file: [(len(n), n, t) for n, t in re.findall(r"0*(\d*)(\D*)", file.name)])
    if not files:
        raise FrameError(f"{folder} holds no image files")
    return (Frame(file, round(i * 1e9 / fps)) for i, file in enumerate(files))


def paced(frames: Iterable[Frame], speed: float = 1.0) -> Iterator[Frame]:
    """The frames at the pace of their times, or so many times as fast."""
    began, first_ns = time.monotonic(), None
    for frame in frames:
        first_ns = frame.timestamp_ns if first_ns is None else first_ns
        due = began + (frame.timestamp_ns - first_ns) * 1e-9 / speed
        time.sleep(max(0.0, due - time.monotonic()))
        yield frame


def nanoseconds(seconds: str) -> int:
    """Decimal seconds as nanoseconds, exactly."""
    whole, _, decimals = seconds.strip().partition(".")
    sign = -1 if whole.startswith("-") else 1
    return int(whole) * 10**9 + sign * int((decimals + "000000000")[:9])


def _row(line: str) -> tuple[str, str]:
    """Time and name, with blanks, a comma or a semicolon between."""
    time_, name = re.split(r"[,;\s]+", line.strip(), maxsplit=1)
    return time_, name.rstrip(",; ")


def _listed(folder: Path, name: str) -> Path:
    """A name may have blanks; or other columns follow it."""
    whole = folder / name
    return whole if whole.is_file() else folder / re.split(r"[,;\s]", name, maxsplit=1)[0]


def _read_calibration(path: Path) -> Camera:
    c = json.loads(path.read_text(encoding="utf-8-sig"))
    model = CameraModel(c.get("model", "pinhole"))
    distortion = tuple(float(x) for x in c.get("dist", []))
    return Camera(c["width"], c["height"], c["fx"], c["fy"], c["cx"], c["cy"], distortion, model)
