"""Client of the monoslam server: stream images of one camera, get poses back, read maps as numpy arrays.

    from monoslam import Client, Folder

    recording = Folder.open("path/to/recording")
    with Client("http://127.0.0.1:50051") as client:
        client.create_session("kitchen", recording.camera)
        for answer in client.stream("kitchen", recording):
            print(answer.sequence, answer.pose.position if answer.pose else answer.reason)
        print(client.points("kitchen").position)

`Client` waits, `monoslam.aio.AsyncClient` is awaited. Every error is a `MonoslamError` whose text is a
sentence.
"""

from ._client import Client
from ._stream import FrameStream
from .aio import AsyncClient, AsyncFrameStream
from .arrays import NONE, Keyframes, Lines, Map, Points, Primitives, Trajectory
from .errors import (
    AddressError,
    BusyError,
    ExistsError,
    FrameError,
    InvalidError,
    MonoslamError,
    NotFoundError,
    ProtocolError,
    RefusedError,
    UnreachableError,
    Violation,
)
from .images import jpeg, png
from .model import (
    Answer,
    Camera,
    CameraCorrection,
    CameraModel,
    Event,
    FrameDropped,
    FrameRejected,
    FrameResult,
    Localization,
    MapChange,
    MapCorrection,
    Missed,
    Pose,
    Readout,
    Scale,
    Session,
    SessionOptions,
    TrackingState,
)
from .sources import Folder, Frame, captures, image_files, paced

__version__ = "0.1.0"

__all__ = [
    "NONE",
    "AddressError",
    "Answer",
    "AsyncClient",
    "AsyncFrameStream",
    "BusyError",
    "Camera",
    "CameraCorrection",
    "CameraModel",
    "Client",
    "Event",
    "ExistsError",
    "Folder",
    "Frame",
    "FrameDropped",
    "FrameError",
    "FrameRejected",
    "FrameResult",
    "FrameStream",
    "InvalidError",
    "Keyframes",
    "Lines",
    "Localization",
    "Map",
    "MapChange",
    "MapCorrection",
    "Missed",
    "MonoslamError",
    "NotFoundError",
    "Points",
    "Pose",
    "Primitives",
    "ProtocolError",
    "Readout",
    "RefusedError",
    "Scale",
    "Session",
    "SessionOptions",
    "TrackingState",
    "Trajectory",
    "UnreachableError",
    "Violation",
    "captures",
    "image_files",
    "jpeg",
    "paced",
    "png",
]
