"""The asynchronous client against a real server."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import numpy as np
import pytest
from conftest import Mapped, Server, free_port

from monoslam import (
    AsyncClient,
    Folder,
    Frame,
    FrameError,
    FrameResult,
    NotFoundError,
    SessionOptions,
    TrackingState,
    UnreachableError,
)


def test_both_clients_read_the_same(mapped: Mapped, tmp_path: Path) -> None:
    async def read() -> None:
        async with AsyncClient(mapped.server.address) as client:
            there, here = await client.map(mapped.id), mapped.client.map(mapped.id)
            for part in ["points", "lines", "primitives", "keyframes"]:
                assert np.array_equal(getattr(there, part).id, getattr(here, part).id)
            assert np.array_equal(there.trajectory.position, here.trajectory.position)
            assert await client.sessions() == mapped.client.sessions()
            assert await client.http_address() == mapped.client.http_address()
            found = await client.localize(mapped.id, mapped.room.files[40])
            assert found.state is TrackingState.TRACKED
            [ply] = await client.export(mapped.id, "ply", tmp_path / "room.ply")
            assert ply.read_bytes().startswith(b"ply\n")
            image = await client.keyframe_image(mapped.id, int(there.keyframes.id[0]))
            assert image[:4] == b"\x89PNG"
            with pytest.raises(NotFoundError):
                await client.points("nobody")
            assert await client.session("nobody") is None

    asyncio.run(read())


def test_sessions_are_made_changed_watched_and_deleted(server: Server, room: Folder) -> None:
    async def change() -> None:
        async with AsyncClient(server.address) as client:
            await client.create_session("a", room.camera)
            assert (await client.update_session("a", SessionOptions(seed=4))).options.seed == 4
            assert (await client.set_scale("a", 2.0)).meters_per_unit == 2.0
            events = client.watch("a")
            assert getattr(await anext(events), "id", None) == "a"
            await events.aclose()  # type: ignore[attr-defined]
            await client.delete_session("a")

    asyncio.run(change())


def test_a_server_killed_in_mid_stream_loses_nothing(server: Server, room: Folder) -> None:
    async def stream() -> None:
        async with AsyncClient(server.address) as client:
            await client.create_session("a", room.camera)
            sequences = []
            async for answer in client.stream("a", room):
                sequences.append(answer.sequence)
                if answer.sequence in (12, 45):
                    await asyncio.to_thread(server.kill)
                    await asyncio.to_thread(server.start)
            assert sequences == list(range(len(room)))
            session = await client.session("a")
            assert session is not None
            assert (session.n_frames, session.durable_sequence) == (len(room), len(room) - 1)

    asyncio.run(stream())


def test_frames_may_be_asynchronous_and_given_one_by_one(server: Server, room: Folder) -> None:
    async def frames() -> AsyncIterator[Frame]:
        for frame in room[:5]:
            await asyncio.sleep(0)
            yield frame

    async def stream() -> None:
        async with AsyncClient(server.address) as client:
            await client.create_session("a", room.camera)
            assert len([answer async for answer in client.stream("a", frames())]) == 5
            async with await client.open_stream("a") as stream:
                assert isinstance(await stream.track(room.files[5], room.times_ns[5]), FrameResult)
            with pytest.raises(FrameError, match="gone.png"):
                [answer async for answer in client.stream("a", [Frame("gone.png")])]

    asyncio.run(stream())


def test_a_stream_that_is_left_early_ends(server: Server, room: Folder) -> None:
    async def stream() -> None:
        async with AsyncClient(server.address) as client:
            await client.create_session("a", room.camera)
            answers = client.stream("a", room)
            async for answer in answers:
                if answer.sequence == 5:
                    break
            await answers.aclose()  # type: ignore[attr-defined]
            async with await client.open_stream("a", take_over=True) as stream:
                assert stream.session.next_sequence > 5

    asyncio.run(stream())


def test_a_server_that_is_not_there_is_told_at_once() -> None:
    async def ask() -> None:
        async with AsyncClient(f"127.0.0.1:{free_port()}") as client:
            with pytest.raises(UnreachableError):
                await client.sessions()
            with pytest.raises(UnreachableError):
                await client.open_stream("a")

    asyncio.run(ask())
