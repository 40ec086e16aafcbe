"""A page in the browser on this machine that shows what is tracked, without ever holding up the tracking."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

import cv2

from tracker.errors import LiveError
from tracker.live.moment import Moment
from tracker.live.page_state import LIMITS, PERCENTILES, PageState
from tracker.pipeline import ObjectTracker
from tracker.viz.overlays import overlay

LOOK_EVERY = 1.0
"""How often the pictures are looked at for brightness, blur, residual and disagreement [s]."""

WATCHED = 5.0
"""How long after it was last asked for news a page counts as open [s]; without one nothing is looked at."""

_HOST = "127.0.0.1"
_JPEG_QUALITY = 85
_POLL = 0.1  # for the end [s]
_TIMEOUT = 10.0  # of a browser that does not read what it is sent [s]
_REFUSED = b"this page is for this machine only"


class Page:
    """Serves the page; a listener of `Live`.

    Only this machine can connect, and only under its own names: a site elsewhere that has the browser ask
    here is refused. Nothing can be changed by it. What costs time is done while a page is open only, in
    threads of their own.

    Args:
        port: where; 0: any that is free.
        tracker: of the object and the cameras, for looks of its own: not the one that `Live` has.

    Raises:
        LiveError: the port is in use.
    """

    def __init__(self, port: int, tracker: ObjectTracker) -> None:
        self._tracker, self._state = tracker, PageState(tracker)
        self._changed = threading.Condition()
        self._arrived: list[Moment] = []
        self._moment: Moment | None = None
        self._message: bytes | None = None
        self._picture: tuple[int, bytes] | None = None
        self._asked, self._closing = -WATCHED, False
        self.cameras = tracker.rig.names
        self.faults: Callable[[], Sequence[str]] = tuple
        """Tells what went wrong; whoever knows it sets this."""
        handler = type("Handler", (_Handler,), {"page": self})
        try:
            self._server = ThreadingHTTPServer((_HOST, port), handler)
        except (OSError, OverflowError) as error:
            raise LiveError(f"page {port}: the port cannot be used: {error}") from error
        self._server.daemon_threads, self._server.block_on_close = True, False
        self.port: int = self._server.server_port
        self.address = f"http://{_HOST}:{self.port}"
        self._threads = [
            threading.Thread(
                target=self._server.serve_forever, args=(_POLL,), name="tracker.page", daemon=True
            ),
            threading.Thread(target=self._run, name="tracker.page.state", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def __call__(self, moment: Moment) -> None:
        """Show a moment, some time later."""
        with self._changed:
            # Few: they hold their images.
            self._arrived = [*self._arrived[-30:], moment]
            self._changed.notify_all()

    def close(self) -> None:
        """End the page."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join()

    def note_watcher(self) -> None:
        """Somebody looks at the page now."""
        self._asked = time.monotonic()

    def next_message(self, after: bytes | None) -> bytes | None:
        """The newest message that is not `after`, for the page; None: there is none within a second."""
        self.note_watcher()
        with self._changed:
            self._changed.wait_for(lambda: self._message is not after or self._closing, 1.0)
            return None if self._message is after else self._message

    @property
    def closing(self) -> bool:
        """Whether no more messages come."""
        return self._closing

    def picture(self) -> bytes | None:
        """The newest images with the pose, as a JPEG."""
        with self._changed:
            moment, picture = self._moment, self._picture
        if moment is None:
            return None
        if picture is None or picture[0] != moment.sequence:
            rig, model = self._tracker.rig, self._tracker.model
            image = overlay(moment.shot.images, rig, model, moment.observation)
            content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
            picture = self._picture = moment.sequence, content
        return picture[1]

    def _run(self) -> None:
        looked = -LOOK_EVERY
        while True:
            with self._changed:
                self._changed.wait_for(lambda: bool(self._arrived) or self._closing)
                if self._closing:
                    return
                moments, self._arrived = self._arrived, []
                watched = time.monotonic() - self._asked < WATCHED
            for moment in moments:
                self._state.see(moment)
            newest = moments[-1]
            if watched and time.monotonic() - looked > LOOK_EVERY:
                self._state.look(newest)
                looked = time.monotonic()
            message = json.dumps(self._state.message(newest, self.faults()), allow_nan=False).encode()
            with self._changed:
                self._moment, self._message = newest, message
                self._changed.notify_all()


class _Handler(BaseHTTPRequestHandler):
    """Answers one browser."""

    page: Page
    timeout = _TIMEOUT

    def do_GET(self) -> None:
        """The page, its events, or the newest picture."""
        port = self.page.port
        if self.headers.get("Host") not in (f"{_HOST}:{port}", f"localhost:{port}"):
            self._answer(403, "text/html", _REFUSED)
        elif self.path == "/":
            content = files("tracker.live").joinpath("page.html").read_text(encoding="utf-8")
            about = {"cameras": self.page.cameras, "percentiles": PERCENTILES, "limits": LIMITS}
            self._answer(200, "text/html", content.replace("{{ABOUT}}", json.dumps(about)).encode())
        elif self.path == "/events":
            self._events()
        elif self.path.startswith("/picture"):
            picture = self.page.picture()
            self._answer(200 if picture else 503, "image/jpeg", picture or b"")
        else:
            self._answer(404, "text/html", b"there is no such page")

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing on stderr."""

    def _answer(self, code: int, kind: str, content: bytes) -> None:
        try:
            self.send_response(code)
            self.send_header("Content-Type", f"{kind}; charset=utf-8" if kind == "text/html" else kind)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(content)
        except OSError:
            self.close_connection = True

    def _events(self) -> None:
        """Messages as they come, until the browser has gone."""
        message = None
        self.page.note_watcher()
        try:
            self.send_response(200)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            while not self.page.closing:
                found = self.page.next_message(message)
                if found is None:
                    self.wfile.write(b": nothing new\n\n")
                else:
                    message = found
                    self.wfile.write(b"data: " + found + b"\n\n")
        except OSError:
            self.close_connection = True
