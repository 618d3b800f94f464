"""Images as they are sent: numpy arrays as raw pixels, files as they are, and arrays made PNG or JPEG."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import FrameError
from .v1 import slam_pb2 as pb

Pixels = NDArray[np.uint8] | NDArray[np.uint16]

ImageLike = Pixels | bytes | str | PathLike[str]
"""Pixels (height, width) or (height, width, 3 or 4); the bytes of an image file; or the path of one."""

_ENCODINGS = {
    ("rgb", 3): pb.IMAGE_ENCODING_RGB8,
    ("rgb", 4): pb.IMAGE_ENCODING_RGBA8,
    ("bgr", 3): pb.IMAGE_ENCODING_BGR8,
    ("bgr", 4): pb.IMAGE_ENCODING_BGRA8,
}

# Fast: images of a camera compress to about two thirds in any case.
_PNG_LEVEL = 1


def message(image: ImageLike, channels: str = "rgb") -> pb.Image:
    """The image as it goes to the server. `channels` is the order of an array's colors: "rgb", or "bgr" for
    OpenCV's.

    Raises FrameError if it cannot be read or is none.
    """
    if isinstance(image, np.ndarray):
        return _of_pixels(image, channels)
    if isinstance(image, (bytes, bytearray, memoryview)):
        return pb.Image(data=bytes(image))
    try:
        return pb.Image(data=Path(image).read_bytes())
    except OSError as error:
        raise FrameError(f"{error.filename}: {error.strerror}") from error
    except TypeError as error:
        raise FrameError(
            f"an image is an array, the bytes of a file or its path, not {type(image).__name__}"
        ) from error


def n_held_bytes(image: ImageLike) -> int:
    """What keeping the image costs in memory; a path costs nothing."""
    if isinstance(image, np.ndarray):
        return int(image.nbytes)
    return len(image) if isinstance(image, (bytes, bytearray, memoryview)) else 0


def png(image: Pixels) -> bytes:
    """A gray or RGB(A) array as a PNG file, without loss: about half of the raw bytes for some
    milliseconds."""
    height, width, depth = _shape(image)
    color = {1: 0, 3: 2, 4: 6}[depth]
    big_endian = image.astype(">u2") if image.dtype == np.uint16 else image
    rows = np.ascontiguousarray(big_endian).reshape(height, -1).view(np.uint8)
    # Each row is told as its difference from the row above (filter 2), which is small in an image.
    filtered = np.empty((height, rows.shape[1] + 1), dtype=np.uint8)
    filtered[:, 0] = 2
    filtered[0, 1:] = rows[0]
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
    head = struct.pack(">IIBBBBB", width, height, 8 * image.dtype.itemsize, color, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(filtered.tobytes(), _PNG_LEVEL)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks)


def jpeg(image: NDArray[np.uint8], quality: int = 90) -> bytes:
    """A gray or RGB array as a JPEG file. Needs Pillow: pip install monoslam[jpeg]."""
    try:
        from PIL import Image
    except ImportError as error:
        raise FrameError("JPEG needs Pillow: pip install pillow; png() needs nothing") from error
    _, _, depth = _shape(image)
    if image.dtype != np.uint8 or depth == 4:
        raise FrameError(f"JPEG holds 8-bit gray or RGB, not {image.dtype} of {depth} channels")
    file = BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=quality)
    return file.getvalue()


def _of_pixels(image: NDArray[Any], channels: str) -> pb.Image:
    height, width, depth = _shape(image)
    if depth == 1:
        gray16 = image.dtype == np.uint16
        encoding = pb.IMAGE_ENCODING_GRAY16 if gray16 else pb.IMAGE_ENCODING_GRAY8
        data = image.astype("<u2") if gray16 else image
    elif (channels, depth) in _ENCODINGS and image.dtype == np.uint8:
        encoding, data = _ENCODINGS[channels, depth], image
    else:
        raise FrameError(f'color is 8 bits deep and "rgb" or "bgr", not {image.dtype} "{channels}"')
    return pb.Image(encoding=encoding, width=width, height=height, data=np.ascontiguousarray(data).tobytes())


def _shape(image: NDArray[Any]) -> tuple[int, int, int]:
    """Height, width and channels."""
    if image.dtype not in (np.uint8, np.uint16):
        raise FrameError(
            f"pixels are uint8 or uint16, not {image.dtype}; for 0…1: (255 * image).astype(np.uint8)"
        )
    shape = image.shape if image.ndim == 3 else (*image.shape, 1)
    if len(shape) != 3 or shape[2] not in (1, 3, 4) or 0 in shape:
        raise FrameError(f"an image is (height, width) or (height, width, 3 or 4), not {image.shape}")
    return shape[0], shape[1], shape[2]


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
