"""What only the HTTP interface has."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from urllib.parse import quote

from ._access import Access
from .errors import MonoslamError, NotFoundError, RefusedError, UnreachableError

_TIMEOUT_S = 60.0


def keyframe_image(http: str, access: Access, session_id: str, keyframe_id: int) -> bytes:
    """The image of a keyframe as it was sent."""
    path = f"/v1/sessions/{quote(session_id, safe='')}/keyframes/{int(keyframe_id)}/image"
    return get(f"{http}{path}", access)


def get(url: str, access: Access) -> bytes:
    """The body of a successful answer."""
    try:
        request = urllib.request.Request(url, headers=access.headers)
        with urllib.request.urlopen(request, timeout=_TIMEOUT_S, context=access.ssl_context()) as response:
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
