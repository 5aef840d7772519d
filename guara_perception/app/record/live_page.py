"""Local web page with camera image and advice during the recording of a session."""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Self

import cv2

from guara_perception.arrays import Image
from guara_perception.exceptions import InvalidInput
from guara_perception.images import for_screen
from transport.supervision import supervised

WIDTH_PX = 960
PAGE = Path(__file__).with_suffix(".html")


class LivePage:
    """Server of the live page for this machine only. It runs on its own thread inside a `with` block.

    Attributes:
        address: address to open in a browser.
    """

    def __init__(self, port: int = 0) -> None:
        """Reserve the port; `__enter__` starts the server.

        Args:
            port: port to serve on; 0 = any free port.

        Raises:
            InvalidInput: the port is in use or not allowed.
        """
        self._lock = threading.Lock()
        self._task = self._request = self._advice = ""
        self._picture: Image | None = None
        self._number = 0
        page = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                content, kind = page._answer(self.path.split("?")[0])
                self.send_response(200 if content else 404)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(content)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, format: str, *args: object) -> None:
                """Suppress the log, since every image would add a line."""

        try:
            self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        except OSError as error:
            raise InvalidInput(f"port {port}: {error.strerror}; give another --port") from None
        self._server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}/"

    def __enter__(self) -> Self:
        supervised("live page", self._server.serve_forever).start()
        return self

    def __exit__(self, *error: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def show_task(self, task: str) -> None:
        """Show the name of a new task; remove the request and the advice of the last one."""
        with self._lock:
            self._task, self._request, self._advice = task, "", ""

    def ask(self, request: str) -> None:
        """Show a request to the operator until the next request or task; remove the advice."""
        with self._lock:
            self._request, self._advice = request, ""

    def watch(self, picture: Image, advice: str) -> None:
        """Show a camera image, and advice or another text below the request."""
        with self._lock:
            self._picture, self._advice = picture, advice
            self._number += 1

    def _answer(self, path: str) -> tuple[bytes, str]:
        with self._lock:
            state = {"task": self._task, "request": self._request, "advice": self._advice, "number": self._number}
            picture = self._picture
        if path == "/":
            return PAGE.read_bytes(), "text/html; charset=utf-8"
        if path == "/state.json":
            return json.dumps(state).encode(), "application/json"
        if path == "/picture.jpg" and picture is not None:
            return cv2.imencode(".jpg", for_screen(picture, WIDTH_PX))[1].tobytes(), "image/jpeg"
        return b"", "text/plain"
