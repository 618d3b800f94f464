"""Images, files and tables, without a server."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from monoslam import Camera, Folder, Frame, FrameError, Pose, Scale, image_files, jpeg, paced, png
from monoslam._wire import Address, backoff_s
from monoslam.arrays import Points, seconds
from monoslam.errors import AddressError
from monoslam.images import message
from monoslam.sources import nanoseconds
from monoslam.v1 import slam_pb2 as pb

RANDOM = np.random.default_rng(7)


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (5, 7, 4), (1, 1)])
def test_png_comes_back(shape: tuple[int, ...]) -> None:
    image = RANDOM.integers(0, 256, shape, dtype=np.uint8)
    assert np.array_equal(np.asarray(Image.open(BytesIO(png(image)))), image)


def test_png_of_16_bits_comes_back() -> None:
    image = RANDOM.integers(0, 65536, (6, 4), dtype=np.uint16)
    assert np.array_equal(np.asarray(Image.open(BytesIO(png(image)))).astype(np.uint16), image)


def test_jpeg_is_near() -> None:
    image = np.tile(np.arange(64, dtype=np.uint8), (32, 1))
    decoded = np.asarray(Image.open(BytesIO(jpeg(image)))).astype(int)
    assert np.abs(decoded - image).max() < 8


def test_arrays_are_sent_as_they_are() -> None:
    image = RANDOM.integers(0, 256, (4, 6, 3), dtype=np.uint8)
    assert message(image).encoding == pb.IMAGE_ENCODING_RGB8
    assert message(image, "bgr").encoding == pb.IMAGE_ENCODING_BGR8
    # A view with strides: what is sent is packed.
    sent = message(image[::2, ::2, 0])
    assert (sent.encoding, sent.width, sent.height) == (pb.IMAGE_ENCODING_GRAY8, 3, 2)
    assert sent.data == image[::2, ::2, 0].tobytes()
    deep = message(np.array([[258]], dtype=np.uint16))
    assert (deep.encoding, deep.data) == (pb.IMAGE_ENCODING_GRAY16, b"\x02\x01")


@pytest.mark.parametrize(
    ("image", "sentence"),
    [
        (np.zeros((4, 4)), "pixels are uint8 or uint16, not float64"),
        (np.zeros((4, 4, 2), dtype=np.uint8), "not \\(4, 4, 2\\)"),
        (np.zeros((0, 4), dtype=np.uint8), "not \\(0, 4\\)"),
        (np.zeros((4, 4, 3), dtype=np.uint16), "color is 8 bits deep"),
        ("nowhere.png", "nowhere.png: No such file"),
        (7, "not int"),
    ],
)
def test_what_is_no_image_is_refused_in_a_sentence(image: object, sentence: str) -> None:
    with pytest.raises(FrameError, match=sentence):
        message(image)  # type: ignore[arg-type]


def test_times_are_exact() -> None:
    for text, ns in [("1403715285.262142976", 1403715285262142976), ("-0.5", -500000000), ("7", 7 * 10**9)]:
        assert nanoseconds(text) == ns
    assert seconds(1403715285262142976) == "1403715285.262142976" and seconds(-1) == "-0.000000001"


def test_folders_say_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(FrameError, match="calib.json: No such file"):
        Folder.open(tmp_path)
    (tmp_path / "calib.json").write_text('{"width": 4}')
    (tmp_path / "rgb.txt").write_text("0.0 a.png\n")
    with pytest.raises(FrameError, match="cannot be understood: KeyError"):
        Folder.open(tmp_path)
    with pytest.raises(FrameError, match="holds no image files"):
        image_files(tmp_path, 30)


def test_image_files_come_in_order(tmp_path: Path) -> None:
    for name in ["b.png", "a.JPG", "c.txt", "a10.webp", "a9.png"]:
        (tmp_path / name).touch()
    names = [Path(str(frame.image)).name for frame in image_files(tmp_path, 10)]
    assert names == ["a9.png", "a10.webp", "a.JPG", "b.png"]
    assert [frame.timestamp_ns for frame in image_files(tmp_path, 10)] == [0, 10**8, 2 * 10**8, 3 * 10**8]


def test_lists_may_have_marks_commas_and_blanks(tmp_path: Path) -> None:
    (tmp_path / "my images").mkdir()
    for name in ["my images/frame 1.png", "b.png", "c.png"]:
        (tmp_path / name).touch()
    (tmp_path / "calib.json").write_text(
        '{"width": 4, "height": 4, "fx": 4, "fy": 4, "cx": 2, "cy": 2}', encoding="utf-8-sig"
    )
    text = "0.0 my images/frame 1.png\r\n0.1,b.png\r\n0.2 c.png 0.2 depth/c.png\r\n"
    (tmp_path / "rgb.txt").write_text(text, encoding="utf-8-sig")
    recording = Folder.open(tmp_path)
    assert [file.name for file in recording.files] == ["frame 1.png", "b.png", "c.png"]
    assert recording.times_ns == (0, 10**8, 2 * 10**8)


def test_frames_are_paced() -> None:
    import time

    began = time.monotonic()
    list(paced([Frame(b"", 0), Frame(b"", 10**9)], speed=10))
    assert 0.1 <= time.monotonic() - began < 1.0


def test_addresses_are_checked() -> None:
    assert Address.parse("http://[::1]:50051").target == "[::1]:50051"
    assert str(Address.parse("localhost:7")) == "http://localhost:7"
    for text in ["", "http://h", "ftp://h:1", "h:x", "http://h:1/path"]:
        with pytest.raises(AddressError, match=f"`{text}`"):
            Address.parse(text)


def test_waits_double_up_to_a_limit() -> None:
    assert [backoff_s(n) for n in range(1, 8)] == [0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0]


def test_a_pose_is_a_matrix() -> None:
    # A quarter turn about z.
    pose = Pose(np.array([1.0, 2.0, 3.0]), np.array([0, 0, 0.5**0.5, 0.5**0.5]))
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    assert np.allclose(pose.matrix(), expected)


def test_tables_are_cut_by_masks() -> None:
    ids = np.arange(4)
    points = Points(Scale.METRIC, np.array([0, 0, 1, 1]), ids, np.zeros((4, 3)), ids)
    assert points.of_submap(1).id.tolist() == [2, 3]
    assert points[points.n_observations > 2].id.tolist() == [3] and points[0:2].scale is Scale.METRIC


def test_a_field_of_view_gives_the_focal_length() -> None:
    camera = Camera.from_field_of_view(640, 480, 90.0)
    assert np.allclose([camera.fx, camera.cx, camera.cy], [320, 319.5, 239.5])
