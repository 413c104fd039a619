"""Serving the app to this computer alone."""

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
from workbench.app import uploads
from workbench.app.page import layout
from workbench.app.session import Sessions
from workbench.errors import USER_ERRORS, InputError, format_mistake
from workbench.report.page import pack_plotly
from workbench.robot import RobotFile

log = logging.getLogger("workbench.app")
HOST = "127.0.0.1"
NAMES = (HOST, "localhost")  # by which a browser may call it; another name is a trick of a foreign page
LARGEST = 4 * uploads.LARGEST // 3 + 1_000_000  # bytes of a request: files in base64, and what goes with them
POLICY = (  # nothing comes from elsewhere, and nothing goes there
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; connect-src 'self'; frame-ancestors 'none'; form-action 'none'; base-uri 'none'"
)


def make_app(recordings: Sequence[Source] = (), robot: RobotFile | None = None) -> tuple[Dash, Sessions]:
    """Make the app, and its sessions, which begin with the recordings; close them in the end."""
    app = Dash(
        "pendulum-ident",
        assets_folder=str(Path(__file__).parents[1] / "assets"),
        index_string=layout.write_index(),
        title="pendulum-ident",
        update_title="",
        suppress_callback_exceptions=True,  # stages come and go
        serve_locally=True,
        eager_loading=True,  # of plotly.js, while the user reads the first stage
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
    """Show in the page why an action failed: a file is missing, or the app has a fault."""
    if isinstance(error, USER_ERRORS):
        text = format_mistake(error)
    else:
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{last.filename}, line {last.lineno}"
        log.error("an answer to the page failed: %s, in %s", _describe_error(error), place)
        text = "something went wrong, and the terminal says what: load the page again"
    set_props("notice", {"children": text})


def _guard(server: flask.Flask) -> None:
    """Bound what comes in, and tell the browser to stay here."""
    server.config["MAX_CONTENT_LENGTH"] = LARGEST

    @server.errorhandler(Exception)
    def refuse_request(error: Exception) -> flask.Response | HTTPException:
        if isinstance(error, HTTPException):
            return error
        log.warning("a request made no sense: %s", _describe_error(error))
        return flask.Response("this request makes no sense", status=400, mimetype="text/plain")

    @server.before_request
    def only_from_here() -> None:
        origin = f"http://{flask.request.host}"
        if urlsplit(origin).hostname not in NAMES or any(
            one != origin for one in flask.request.headers.getlist("Origin")
        ):
            flask.abort(403)

    @server.after_request
    def stay_here(response: flask.Response) -> flask.Response:
        response.headers["Content-Security-Policy"] = POLICY
        response.headers["X-Content-Type-Options"] = "nosniff"
        response.headers["Referrer-Policy"] = "no-referrer"
        return response


def _describe_error(error: Exception) -> str:
    """Describe a failed request in one line."""
    return format_mistake(InputError(repr(error)))


class _SilentHandler(WSGIRequestHandler):
    """Says nothing about requests, and ends those that do not go on."""

    timeout = 60.0  # [s] in the middle of a request, after which it is not waited for

    def log(self, type: str, message: str, *args: object) -> None:
        """Say nothing."""


class Server:
    """The app behind a port of this computer: `serve`, then `close`."""

    def __init__(self, port: int = 0, recordings: Sequence[Source] = (), robot: RobotFile | None = None) -> None:
        """Bind the port, 0 being any that is free; raises InputError if it is taken."""
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
        """Answer until an interrupt comes."""
        self.sessions.workers.warm()
        Thread(target=pack_plotly, daemon=True).start()  # packing it takes a moment, and is done once
        self._server.serve_forever()

    def close(self) -> None:
        """End everything, once it does not serve any more."""
        self._server.server_close()
        self.sessions.close()
