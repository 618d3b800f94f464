"""What only the HTTP interface has."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from urllib.parse import quote

from .errors import MonoslamError, NotFoundError, RefusedError, UnreachableError

_TIMEOUT_S = 60.0


def keyframe_image(http: str, session_id: str, keyframe_id: int) -> bytes:
    """The image of a keyframe as it was sent."""
    return get(f"{http}/v1/sessions/{quote(session_id, safe='')}/keyframes/{int(keyframe_id)}/image")


def get(url: str) -> bytes:
    """The body of a successful answer."""
    try:
        with urllib.request.urlopen(url, timeout=_TIMEOUT_S) as response:
            body: bytes = response.read()
            return body
    except urllib.error.HTTPError as error:
        raise _refusal(error) from None
    except OSError as error:
        raise UnreachableError(f"{url} cannot be read: {error}") from None


def _refusal(error: urllib.error.HTTPError) -> MonoslamError:
    """The server's sentence, as its problem details (RFC 9457) have it."""
    try:
        problem = json.loads(error.read(64 << 10))
        sentence, code = problem["detail"], problem["code"]
    except (ValueError, KeyError, TypeError):
        sentence, code = f"the server answered {error.code}", f"HTTP_{error.code}"
    kind = NotFoundError if error.code == 404 else RefusedError
    return kind(sentence, code)
