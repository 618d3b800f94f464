"""The client against a real server."""

from __future__ import annotations

import threading
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from conftest import Mapped, Server, free_port
from PIL import Image

from monoslam import (
    BusyError,
    Camera,
    Client,
    ExistsError,
    Folder,
    Frame,
    FrameError,
    FrameRejected,
    FrameResult,
    InvalidError,
    MonoslamError,
    NotFoundError,
    Scale,
    SessionOptions,
    TrackingState,
    UnreachableError,
)

CAMERA = Camera(640, 480, 460.0, 460.0, 319.5, 239.5)


def gray(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("L"))


def test_sessions_are_made_listed_changed_and_deleted(client: Client) -> None:
    made = client.create_session("a", CAMERA, SessionOptions(seed=3, lines=False, global_primitives=False))
    assert (made.camera, made.options.seed, made.state) == (CAMERA, 3, TrackingState.UNKNOWN)
    client.create_session("", CAMERA)
    assert len(client.sessions()) == 2 and client.session("b") is None
    assert client.update_session("a", SessionOptions(seed=4)).options.lines is False
    scaled = client.set_scale("a", 2.5)
    assert scaled.meters_per_unit == 2.5 and client.set_scale("a", None).meters_per_unit is None
    client.delete_session("a")
    assert client.session("a") is None


def test_a_camera_extends_the_map_of_another_session(client: Client) -> None:
    client.create_session("a", CAMERA)
    added = client.create_session("b", None, SessionOptions(n_features=900), map="a")
    assert (added.map, added.camera, added.options.n_features) == ("a", CAMERA, 900)
    assert client.create_session("c", Camera(320, 240, 300.0, 300.0, 159.5, 119.5), map="b").map == "a"
    with pytest.raises(InvalidError) as invalid:
        client.create_session("d", None, SessionOptions(loop_closing=False), map="a")
    assert invalid.value.violations[0].field == "options.loop_closing"
    with pytest.raises(BusyError) as shared:
        client.delete_session("a")
    assert shared.value.code == "MAP_SHARED" and "b" in str(shared.value)
    for session in ("b", "c", "a"):
        client.delete_session(session)


def test_refusals_are_sentences_with_codes(client: Client) -> None:
    client.create_session("a", CAMERA)
    with pytest.raises(ExistsError) as exists:
        client.create_session("a", CAMERA)
    assert exists.value.code == "SESSION_EXISTS" and "a" in str(exists.value)
    with pytest.raises(InvalidError) as invalid:
        client.create_session("b", Camera(640, 480, -1.0, 460.0, 319.5, 239.5))
    assert invalid.value.violations[0].field == "camera.fx"
    with pytest.raises(NotFoundError, match="nobody"):
        client.points("nobody")
    with pytest.raises(NotFoundError):
        client.keyframe_image("a", 12)
    with pytest.raises(NotFoundError):
        next(client.watch("nobody"))


def test_a_server_that_is_not_there_is_told_at_once() -> None:
    with Client(f"127.0.0.1:{free_port()}") as client:
        with pytest.raises(UnreachableError, match="cannot be reached"):
            client.sessions()
        with pytest.raises(UnreachableError):
            client.open_stream("a")


def test_the_http_address_is_told_and_is_no_grpc_one(server: Server, client: Client) -> None:
    assert client.http_address() == f"http://{server.http}"
    with Client(f"http://{server.http}") as wrong, pytest.raises(MonoslamError):
        wrong.sessions()


def test_a_recording_becomes_a_map(mapped: Mapped) -> None:
    assert [answer.sequence for answer in mapped.answers] == list(range(len(mapped.room)))
    tracked = [a for a in mapped.answers if isinstance(a, FrameResult) and a.state is TrackingState.TRACKED]
    assert len(tracked) > 0.8 * len(mapped.room) and all(answer.pose for answer in tracked)
    assert tracked[-1].timings.total_ms > 0 and tracked[-1].timings.stages
    session = mapped.client.session(mapped.id)
    assert session is not None and session.durable_sequence == len(mapped.room) - 1


def test_maps_come_as_arrays(mapped: Mapped) -> None:
    room = mapped.client.map(mapped.id)
    session = mapped.client.session(mapped.id)
    assert session is not None
    assert (len(room.points), len(room.lines)) == (session.n_points, session.n_lines)
    assert (len(room.primitives), len(room.keyframes)) == (session.n_primitives, session.n_keyframes)
    assert room.points.position.shape == (session.n_points, 3) and np.isfinite(room.points.position).all()
    assert np.allclose(np.linalg.norm(room.lines.direction, axis=1), 1)
    # The moment is any point of the line times its direction.
    assert np.allclose(np.cross(room.lines.start, room.lines.direction), room.lines.moment, atol=1e-6)
    assert set(room.lines.primitive_id.tolist()) <= {-1, *room.primitives.id.tolist()}
    assert room.primitives.covariance.shape == (session.n_primitives, 3, 3)
    assert room.keyframes.parent.tolist().count(-1) == 1
    assert np.allclose(np.linalg.det(room.trajectory.matrices()[:, :3, :3]), 1)
    assert (np.diff(room.trajectory.timestamp_ns) > 0).all() and room.points.scale is Scale.UP_TO_SCALE
    assert len(mapped.client.trajectory(mapped.id, keyframes=True)) == session.n_keyframes


def test_parts_of_maps_are_asked_for(mapped: Mapped) -> None:
    points = mapped.client.points(mapped.id)
    center = points.position[len(points) // 2]
    near = mapped.client.points(mapped.id, near=center, radius=0.2)
    distance = np.linalg.norm(points.position - center, axis=1)
    assert set(near.id) == set(points.id[distance <= 0.2]) and 0 < len(near) < len(points)
    boxed = mapped.client.points(mapped.id, bbox=(center - 0.1, center + 0.1), min_observations=3)
    inside = (np.abs(points.position - center) <= 0.1).all(axis=1) & (points.n_observations >= 3)
    assert set(boxed.id) == set(points.id[inside])
    primitive = int(mapped.client.primitives(mapped.id).id[0])
    lines = mapped.client.lines(mapped.id, primitive_id=primitive)
    assert len(lines) > 0 and set(lines.primitive_id) == {primitive}
    assert len(mapped.client.points(mapped.id, submap_id=77)) == 0


def test_an_image_is_located_in_the_map(mapped: Mapped) -> None:
    trajectory = mapped.client.trajectory(mapped.id)
    row = len(trajectory) // 2
    sequence = int(trajectory.sequence[row])
    found = mapped.client.localize(mapped.id, gray(mapped.room.files[sequence]))
    assert found.state is TrackingState.TRACKED and found.pose is not None
    extent = np.ptp(trajectory.position, axis=0).max()
    assert np.linalg.norm(found.pose.position - trajectory.position[row]) < 0.02 * extent
    lost = mapped.client.localize(mapped.id, np.zeros((480, 640), dtype=np.uint8))
    assert lost.state is TrackingState.LOST and lost.pose is None and lost.reason


def test_maps_are_exported(mapped: Mapped, tmp_path: Path) -> None:
    [ply] = mapped.client.export(mapped.id, "ply", tmp_path / "room.ply")
    assert ply.read_bytes().startswith(b"ply\n")
    [document] = mapped.client.export(mapped.id, "json", tmp_path / "room.json")
    assert b'"points"' in document.read_bytes()
    [log] = mapped.client.export(mapped.id, "mcap", tmp_path / "room.mcap")
    assert log.read_bytes().startswith(b"\x89MCAP0")
    [transforms] = mapped.client.export(mapped.id, "transforms", tmp_path / "transforms.json")
    assert b'"frames"' in transforms.read_bytes()
    model = mapped.client.export(mapped.id, "colmap", tmp_path / "model")
    assert [file.name for file in model] == ["cameras.txt", "images.txt", "points3D.txt"]
    assert all(file.stat().st_size > 0 for file in model)


def test_a_keyframe_shows_its_image(mapped: Mapped) -> None:
    keyframes = mapped.client.keyframes(mapped.id)
    first = keyframes[keyframes.has_image][0:1]
    image = mapped.client.keyframe_image(mapped.id, int(first.id[0]))
    assert image == mapped.room.files[int(first.sequence[0])].read_bytes()


def test_what_happens_is_watched(client: Client, room: Folder) -> None:
    client.create_session("a", room.camera)
    events = client.watch("a")
    first = next(events)
    assert getattr(first, "id", None) == "a"
    streaming = threading.Thread(target=lambda: list(client.stream("a", room[:5])))
    streaming.start()
    sequences = [event.sequence for event in islice(events, 5) if isinstance(event, FrameResult)]
    streaming.join()
    assert sequences == sorted(sequences) and 0 in sequences
    events.close()


def test_arrays_files_and_bytes_are_the_same_frames(client: Client, room: Folder) -> None:
    client.create_session("a", room.camera)
    path, t = room.files[0], room.times_ns
    with client.open_stream("a") as stream:
        keypoints = []
        for i, image in enumerate([gray(path), path.read_bytes(), path, np.stack([gray(path)] * 3, -1)]):
            answer = stream.track(image, t[i])
            assert isinstance(answer, FrameResult)
            keypoints.append(answer.n_keypoints)
    assert len(set(keypoints)) == 1 and keypoints[0] > 100


def test_a_frame_that_cannot_be_used_is_answered_and_the_stream_goes_on(client: Client, room: Folder) -> None:
    client.create_session("a", room.camera)
    with client.open_stream("a") as stream:
        wrong = stream.track(np.zeros((240, 320), dtype=np.uint8), 1)
        assert isinstance(wrong, FrameRejected) and wrong.code == "WRONG_IMAGE_SIZE" and wrong.pose is None
        assert isinstance(stream.track(room.files[0], 2), FrameResult)
        assert isinstance(stream.track(room.files[1], 2), FrameRejected)


def test_frames_that_cannot_be_read_end_the_stream_with_a_sentence(client: Client, room: Folder) -> None:
    client.create_session("a", room.camera)
    missing = [Frame(room.files[0], 1), Frame("gone.png", 2)]
    with pytest.raises(FrameError, match="frame 1: gone.png: No such file"):
        list(client.stream("a", missing))

    def broken() -> object:
        yield Frame(room.files[2], 3)
        raise RuntimeError("the lens cap is on")

    with pytest.raises(FrameError, match="the lens cap is on"):
        list(client.stream("a", broken()))  # type: ignore[arg-type]


def test_one_writer_at_a_time_and_who_takes_over_ends_the_other(client: Client, room: Folder) -> None:
    client.create_session("a", room.camera)
    first = client.open_stream("a")
    with pytest.raises(BusyError) as busy:
        client.open_stream("a")
    assert busy.value.code == "WRITER_CONNECTED"
    with client.open_stream("a", take_over=True) as second:
        assert isinstance(second.track(room.files[0], 1), FrameResult)
    with pytest.raises(MonoslamError):
        first.close()


def test_a_source_is_not_read_ahead_of_the_server(client: Client, room: Folder) -> None:
    client.create_session("a", room.camera)
    n_taken, furthest = 0, 0

    def counted() -> object:
        nonlocal n_taken
        for frame in room[:40]:
            n_taken += 1
            yield frame

    for answer in client.stream("a", counted()):  # type: ignore[arg-type]
        furthest = max(furthest, n_taken - answer.sequence)
    # The window, the frame in hand, and what was answered while this loop looked away.
    assert 1 < furthest <= 24, furthest


def test_answers_that_nobody_reads_do_not_grow_without_end(
    client: Client, room: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("monoslam._stream.MAX_UNREAD", 3)
    client.create_session("a", room.camera)
    stream = client.open_stream("a", window=1)
    with pytest.raises(MonoslamError, match="answers wait to be read"):
        for frame in room:
            stream.send(frame)
    stream.cancel()


def test_a_real_time_stream_answers_every_frame_also_those_it_drops(client: Client, room: Folder) -> None:
    client.create_session("a", room.camera)
    answers = list(client.stream("a", room[:40], policy="realtime"))
    assert [answer.sequence for answer in answers] == list(range(40))


def test_a_recording_goes_on_where_it_ended(client: Client, room: Folder) -> None:
    client.create_session("a", room.camera)
    assert len(list(client.stream("a", room[:20]))) == 20
    rest = [answer.sequence for answer in client.stream("a", room[:30], resume=True)]
    assert rest == list(range(20, 30))


@pytest.mark.parametrize("as_arrays", [False, True])
def test_a_server_killed_in_mid_stream_loses_nothing(
    server: Server, client: Client, room: Folder, as_arrays: bool
) -> None:
    """Files can be read again; arrays, as a camera gives them, cannot, and are held until they are
    durable."""
    client.create_session("a", room.camera)
    frames = [Frame(gray(Path(str(f.image))), f.timestamp_ns) for f in room] if as_arrays else room
    sequences = []
    for answer in client.stream("a", frames):
        sequences.append(answer.sequence)
        if answer.sequence in (12, 45):
            server.kill()
            server.start()
    assert sequences == list(range(len(room)))
    session = client.session("a")
    assert session is not None and session.n_frames == len(room)
    assert session.durable_sequence == len(room) - 1 and session.last_timestamp_ns == room.times_ns[-1]
    trajectory = client.trajectory("a")
    assert len(np.unique(trajectory.sequence)) == len(trajectory) > 0.7 * len(room)


def test_a_real_time_stream_sends_again_only_what_the_server_can_queue(
    server: Server, client: Client, room: Folder
) -> None:
    client.create_session("a", room.camera)
    n_tracked = 0
    for answer in client.stream("a", room[:40], policy="realtime"):
        n_tracked += isinstance(answer, FrameResult)
        if answer.sequence == 30:
            server.kill()
            server.start()
    session = client.session("a")
    assert session is not None and session.n_frames == n_tracked


def test_a_server_killed_after_the_last_answer_loses_nothing(
    server: Server, client: Client, room: Folder
) -> None:
    client.create_session("a", room.camera)
    stream = client.open_stream("a")
    sending = threading.Thread(target=lambda: [stream.send(frame) for frame in room[:40]])
    sending.start()
    for answer in stream:
        if answer.sequence == 39:
            break
    sending.join()
    server.kill()
    server.start()
    stream.close()
    session = client.session("a")
    assert session is not None and session.durable_sequence == 39 and stream.n_missing == 0


def test_a_stream_that_is_left_early_ends(client: Client, room: Folder) -> None:
    client.create_session("a", room.camera)
    for answer in client.stream("a", room):
        if answer.sequence == 5:
            break
    # The writer is gone: another one is let in.
    with client.open_stream("a", take_over=True) as stream:
        assert stream.session.next_sequence > 5


def test_answers_may_be_called_back(client: Client, room: Folder) -> None:
    client.create_session("a", room.camera)
    heard: list[int] = []
    with client.open_stream("a", on_answer=lambda answer: heard.append(answer.sequence)) as stream:
        for frame in room[:10]:
            stream.send(frame)
    assert heard == list(range(10))
    failing = client.open_stream("a", on_answer=lambda _: 1 / 0)
    failing.send(Frame(room.files[10], room.times_ns[10]))
    with pytest.raises(MonoslamError, match="on_answer failed: ZeroDivisionError"):
        failing.close()


def test_a_map_is_only_looked_at(client: Client, room: Folder) -> None:
    client.create_session("a", room.camera)
    list(client.stream("a", room[:40]))
    before = client.session("a")
    answers = list(client.stream("a", room[40:50], mode="localize"))
    after = client.session("a")
    assert before is not None and after is not None
    assert any(answer.pose for answer in answers) and after.n_keyframes == before.n_keyframes
