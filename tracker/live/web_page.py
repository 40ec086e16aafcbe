"""A web page on this machine that shows the newest moment and each camera's health."""

import json
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

import cv2
import numpy as np

from tracker.calibration.by_object.health import QUANTITIES, sample, surely_still
from tracker.checks import naming
from tracker.errors import LiveError
from tracker.live.camera_check import MOST_MISSING, MOST_SKEW
from tracker.live.listeners import WAITING, Listener
from tracker.live.moment import Moment
from tracker.pipeline import ObjectTracker
from tracker.summaries.remarks import MOST_BLUR, PictureLook
from tracker.viz.overlays import overlay

SPAN = 10.0
"""Time window for rates, skews and missing images [s]."""

LATENCIES = 600
"""Number of latencies whose percentiles are shown: a minute at 10 Hz."""

PERCENTILES = (50, 90, 99, 100)

LIMITS = {
    "missing": (0.0, 100 * MOST_MISSING),
    "skew": (0.0, 1e3 * MOST_SKEW),
    "level": QUANTITIES["brightness"].limits,
    "clipped": QUANTITIES["clipping"].limits,
    "blur": (0.0, MOST_BLUR),
    **{key: QUANTITIES[key].limits for key in ("residual", "disagreement")},
}
"""Good values, in the units of `WebPageState.message`, as for `--check` and the health of a recording."""


class WebPageState:
    """Statistics of moments for the page; not thread-safe. The tracker is not the one that `Live` uses."""

    def __init__(self, tracker: ObjectTracker) -> None:
        self._tracker, self._names = tracker, tracker.rig.names
        self._latencies: deque[float] = deque(maxlen=LATENCIES)
        self._seen: deque[tuple[float, tuple[float | None, ...], Mapping[str, str]]] = deque()
        self._looks: list[dict[str, float]] = [{} for _ in self._names]
        self._disagreement = [math.nan] * len(self._names)

    def see(self, moment: Moment) -> None:
        """Count a moment."""
        now, taken = time.monotonic(), moment.taken
        self._latencies.append(moment.latency)
        skews = tuple(
            None if image is None else 1e3 * (taken.timestamp - stamp)
            for image, stamp in zip(taken.images, taken.stamps, strict=True)
        )
        self._seen.append((now, skews, moment.faults))
        while self._seen[0][0] < now - SPAN:
            self._seen.popleft()

    def look(self, moment: Moment) -> None:
        """Measure the images themselves, which takes tens of milliseconds."""
        images, pose = moment.taken.images, moment.filtered_object_pose
        self._looks = [{} if image is None else PictureLook.of(image)._asdict() for image in images]
        found = None if pose is None else sample(self._tracker, images, still=surely_still(pose))
        if found is not None and found.look is not None:
            self._disagreement = found.values["disagreement"].tolist()
        for c, look in enumerate(self._looks):
            look["disagreement"] = self._disagreement[c]  # measured only at rest, and kept from then on
            look["residual"] = math.nan if found is None else float(found.values["residual"][c])

    def message(self, moment: Moment, faults: Sequence[str]) -> dict[str, Any]:
        """Return the page's message about a moment; null stands for unknown values.

        `time` [s]; `position` [mm], `std_mm`, `std_deg` and `confidence` of the filtered pose; `measured`,
        whether a pose was measured in these images; `latency` and its percentiles `latency_ms` [ms]. For each
        camera: the `last_fault` within SPAN and its age [s], `rate` [Hz], `missing` and `clipped` [%], `skew`
        [ms], median grey `level`, `blur` [px], `residual` [px, scaled to an object of 55 px],
        `disagreement` [mrad], and in `beyond` which of these are beyond `LIMITS`.
        """
        pose = moment.filtered_object_pose
        std = None if pose is None else np.sqrt(np.diag(pose.covariance))
        return {
            "sequence": moment.sequence,
            "time": moment.timestamp,
            "status": moment.status.value,
            "measured": moment.object_pose is not None,
            "position": None if pose is None else (1e3 * pose.position).tolist(),
            "std_mm": None if std is None else (1e3 * std[:3]).tolist(),
            "std_deg": None if std is None else np.degrees(std[3:]).tolist(),
            "confidence": None if pose is None else float(pose.confidence),
            "latency": 1e3 * moment.latency,
            "percentiles": PERCENTILES,
            "latency_ms": [float(np.percentile(self._latencies, p)) * 1e3 for p in PERCENTILES],
            "cameras": [self._camera(c, moment) for c in range(len(self._names))],
            "faults": list(faults[-5:]),
        }

    def _camera(self, c: int, moment: Moment) -> dict[str, Any]:
        skews = [each[c] for _, each, _ in self._seen]
        there = [skew for skew in skews if skew is not None]
        seconds = self._seen[-1][0] - self._seen[0][0]
        values = {
            **dict.fromkeys(LIMITS, math.nan),
            **self._looks[c],
            "rate": len(there) / len(skews) * (len(skews) - 1) / seconds if seconds > 0 else math.nan,
            "missing": 100 * skews.count(None) / len(skews),
            "skew": float(np.median(there)) if there else math.nan,
        }
        beyond = [key for key, (low, high) in LIMITS.items() if values[key] < low or values[key] > high]
        name, uses = self._names[c], moment.cameras
        past = ((self._seen[-1][0] - when, its[name]) for when, _, its in reversed(self._seen) if name in its)
        age, last = next(past, (None, None))
        return {
            "name": name,
            "use": uses[c].value if uses else None,
            "fault": moment.faults.get(name),
            "last_fault": last,
            "last_fault_age": age,
            **{key: value if math.isfinite(value) else None for key, value in values.items()},
            "beyond": beyond,
        }


LOOK_EVERY = 1.0
"""Interval between measurements of brightness, clipping, blur, residual and disagreement [s]."""

WATCHED = 5.0
"""How long a page counts as open after its last request [s]; without an open page nothing is measured."""

CONNECTIONS = 16
"""Largest number of connections; each takes a thread and a file handle, which cameras and disk need, too."""

_HOST = "127.0.0.1"
_POLL = 0.1  # interval at which the server checks whether to end [s]


class WebPage(Listener):
    """Serves the page on a port of this machine, 0: any free one; LiveError if it cannot be used.

    Only this machine can connect, and only by its local host names: requests that another site makes through
    a browser are refused. Connections beyond CONNECTIONS are closed. The page cannot change anything. Costly
    work is done only while a page is open, in separate threads, with a tracker that `Live` does not use.
    """

    def __init__(self, port: int, tracker: ObjectTracker) -> None:
        self._tracker, self._state = tracker, WebPageState(tracker)
        self._moment: Moment | None = None
        self._message = b""
        self._picture = -1, b""
        self._asked = self._looked = -math.inf
        self.faults: Callable[[], Sequence[str]] = tuple  # returns those to show; set by the caller
        with naming(f"page {port}: the port cannot be used", LiveError, OSError, OverflowError, TypeError):
            self._server = _Server((_HOST, port), type("Handler", (_Handler,), {"page": self}))
        self.port: int = self._server.server_port
        self.address = f"http://{_HOST}:{self.port}"
        serve = self._server.serve_forever
        threading.Thread(target=serve, args=(_POLL,), name="tracker.page", daemon=True).start()
        super().__init__(WAITING)

    def close(self) -> None:
        """End the server."""
        super().close()
        self._server.shutdown()
        self._server.server_close()

    @property
    def is_open(self) -> bool:
        """Whether a browser shows the page."""
        return time.monotonic() - self._asked < WATCHED

    def message(self, after: str) -> bytes:
        """Return the newest message if it is not that of set `after`; empty if none came within a second."""
        self._asked = time.monotonic()

        def is_newer() -> bool:
            return self._moment is not None and str(self._moment.sequence) != after

        with self._changed:
            self._changed.wait_for(lambda: is_newer() or self._closing, 1.0)
            return self._message if is_newer() else b""

    def picture(self) -> bytes:
        """Return the newest images with the pose, as a JPEG; empty if there are none yet."""
        moment = self._moment
        if moment is not None and self._picture[0] != moment.sequence:
            image = overlay(moment.taken.images, self._tracker.rig, self._tracker.model, moment.observation)
            content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
            self._picture = moment.sequence, content
        return self._picture[1]

    def _take_in(self, moment: Moment) -> None:
        self._state.see(moment)
        if self._waiting:
            return  # only the newest is shown
        if self.is_open and time.monotonic() - self._looked > LOOK_EVERY:
            self._state.look(moment)
            self._looked = time.monotonic()
        message = json.dumps(self._state.message(moment, self.faults()), allow_nan=False).encode()
        with self._changed:
            self._moment, self._message = moment, message
            self._changed.notify_all()


class _Server(ThreadingHTTPServer):
    daemon_threads, block_on_close, request_queue_size = True, False, CONNECTIONS

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._open: set[Any] = set()
        super().__init__(address, handler)

    def verify_request(self, request: Any, client: Any) -> bool:
        """Return whether there is room for a connection; if not, it is closed."""
        if len(self._open) < CONNECTIONS:
            self._open.add(request)
        return request in self._open

    def shutdown_request(self, request: Any) -> None:
        super().shutdown_request(request)
        self._open.discard(request)

    def handle_error(self, request: Any, client: Any) -> None:
        """Print nothing on stderr when a browser disconnects."""


class _Handler(BaseHTTPRequestHandler):
    page: WebPage
    timeout = 10.0  # for a browser that does not read its response [s]

    def do_GET(self) -> None:
        if not self._is_own():
            self._answer(403, "text/html", b"this page is for this machine only")
        elif self.path == "/":
            self._answer(200, "text/html", files("tracker.live").joinpath("web_page.html").read_bytes())
        elif self.path.startswith("/message"):
            message = self.page.message(self.path.partition("?")[2])
            self._answer(200 if message else 204, "application/json", message)
        elif self.path.startswith("/picture"):
            picture = self.page.picture()
            self._answer(200 if picture else 204, "image/jpeg", picture)
        else:
            self._answer(404, "text/html", b"there is no such page")

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing on stderr."""

    def _is_own(self) -> bool:
        """Return whether the request uses this machine's local names and does not come from another site."""
        ports = [f":{self.page.port}", *([""] if self.page.port == 80 else [])]  # browsers leave out 80
        hosts = [f"{name}{port}" for name in (_HOST, "localhost") for port in ports]
        origin, site = self.headers.get("Origin"), self.headers.get("Sec-Fetch-Site", "none")
        return (
            self.headers.get("Host") in hosts
            and origin in (None, *(f"http://{host}" for host in hosts))
            # A link on another site may lead here; its images and scripts may not request anything.
            and (site in ("none", "same-origin") or self.headers.get("Sec-Fetch-Dest") == "document")
        )

    def _answer(self, code: int, kind: str, content: bytes) -> None:
        try:
            self.send_response(code)
            self.send_header("Content-Type", f"{kind}; charset=utf-8" if kind == "text/html" else kind)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Frame-Options", "DENY")
            self.end_headers()
            self.wfile.write(content)
        except OSError:
            self.close_connection = True
