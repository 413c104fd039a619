"""Server of the app, reachable from this computer only."""

import logging
import socket
import traceback
from collections.abc import Sequence
from pathlib import Path
from threading import Thread
from urllib.parse import urlsplit

import flask
from dash import Dash, set_props
from werkzeug.exceptions import HTTPException
from werkzeug.serving import WSGIRequestHandler, make_server

from pendulum_env.recording import Source
from pendulum_env.robot_file import RobotFile
from workbench.app import uploads
from workbench.app.page import layout
from workbench.app.session import Sessions
from workbench.errors import USER_ERRORS, InputError, format_mistake
from workbench.report.page import pack_plotly, read_shared

log = logging.getLogger("workbench.app")
HOST = "127.0.0.1"
NAMES = (HOST, "localhost")  # accepted host names: others indicate DNS rebinding
LARGEST = 4 * uploads.LARGEST // 3 + 1_000_000  # largest request [bytes]: files in base64, and form data
POLICY = (  # no requests to other hosts
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; connect-src 'self'; frame-ancestors 'none'; form-action 'none'; base-uri 'none'"
)


def make_app(recordings: Sequence[Source] = (), robot: RobotFile | None = None) -> tuple[Dash, Sessions]:
    """Make the app and its sessions, which start with the recordings and the robot; the caller closes them."""
    app = Dash(
        "pendulum-ident",
        assets_folder=str(Path(__file__).parents[1] / "assets"),
        index_string=read_shared("app.html"),
        title="pendulum-ident",
        update_title="",
        suppress_callback_exceptions=True,  # components of other stages are missing
        serve_locally=True,
        eager_loading=True,  # of plotly.js
        compress=False,
        enable_mcp=False,
        add_log_handler=False,
        on_error=_report_error,
    )
    sessions = Sessions(recordings, robot)
    app.layout = layout.make_page()
    layout.connect(app, sessions)
    _guard(app.server)
    return app, sessions


def _report_error(error: Exception) -> None:
    """Show the error of a failed callback on the page; log it unless the user caused it."""
    if isinstance(error, USER_ERRORS):
        text = format_mistake(error)
    else:
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{last.filename}, line {last.lineno}"
        log.error("an answer to the page failed: %s, in %s", _describe_error(error), place)
        text = "something went wrong, and the terminal says what: load the page again"
    set_props("notice", {"children": text})


def _guard(server: flask.Flask) -> None:
    """Limit the size and origin of requests, and set the security headers of responses."""
    server.config["MAX_CONTENT_LENGTH"] = LARGEST

    @server.errorhandler(Exception)
    def refuse_request(error: Exception) -> flask.Response | HTTPException:
        if isinstance(error, HTTPException):
            return error
        log.warning("a request made no sense: %s", _describe_error(error))
        return flask.Response("this request makes no sense", status=400, mimetype="text/plain")

    @server.before_request
    def refuse_foreign_host() -> None:
        origin = f"http://{flask.request.host}"
        if urlsplit(origin).hostname not in NAMES or any(
            sender != origin for sender in flask.request.headers.getlist("Origin")
        ):
            flask.abort(403)

    @server.after_request
    def set_security_headers(response: flask.Response) -> flask.Response:
        response.headers["Content-Security-Policy"] = POLICY
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Referrer-Policy"] = "no-referrer"
        return response


def _describe_error(error: Exception) -> str:
    """Format an exception as one printable line."""
    return format_mistake(InputError(repr(error)))


class _SilentHandler(WSGIRequestHandler):
    """Request handler without log, and with a time limit."""

    timeout = 60.0  # [s] without data in the middle of a request

    def log(self, type: str, message: str, *args: object) -> None:
        """Suppress the message."""


class Server:
    """Server of the app on a local port: call `serve`, then `close`."""

    def __init__(self, port: int = 0, recordings: Sequence[Source] = (), robot: RobotFile | None = None) -> None:
        """Bind the port, or any free port for 0; raises InputError if the port is taken."""
        try:
            listening = socket.create_server((HOST, port))
        except OSError:
            raise InputError(f"port {port} is taken: name another with --port, or 0 for any that is free") from None
        with listening:
            app, self.sessions = make_app(recordings, robot)
            number = listening.getsockname()[1]
            self._server = make_server(
                HOST, number, app.server, threaded=True, request_handler=_SilentHandler, fd=listening.fileno()
            )
        self.address = f"http://{HOST}:{number}/"

    def serve(self) -> None:
        """Serve requests until an interrupt."""
        self.sessions.workers.start_spare()
        Thread(target=pack_plotly, daemon=True).start()  # cached for the first report
        self._server.serve_forever()

    def close(self) -> None:
        """Close the port and all sessions, after `serve` has returned."""
        self._server.server_close()
        self.sessions.close()
