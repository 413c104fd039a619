"""`app`: serve the workbench in a browser."""

import argparse
import signal
import sys
import webbrowser
from importlib.util import find_spec
from threading import Timer

from pendulum_env.errors import ColumnError, MotionlessError
from pendulum_env.recording import Source
from pendulum_env.settings import use_writer
from workbench import options
from workbench.app.card import write_choice
from workbench.errors import InputError
from workbench.inputs import list_sources, read_all
from workbench.processes import hold_interrupts
from workbench.robot import make_robot
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare initial recordings, port and browser."""
    options.declare(parser, "recordings", nargs="*", help=f"{options.KINDS}; to begin with")
    options.declare(parser, *options.READING)
    parser.add_argument(
        "--port", type=options.convert_number(0, 65535), default=8050, help="of this computer (default 8050); 0: any"
    )
    parser.add_argument("--no-browser", action="store_true", help="open none, only print the address")
    options.add_robot(parser, pendulums=["drive"])


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Serve until interrupted."""
    if find_spec("dash") is None:
        raise InputError("the workbench in a browser needs the extra app: pip install 'pendulum-ident[app]'")
    recordings = list_sources(arguments)
    robot = make_robot(arguments, recordings) if arguments.robot is not None else None
    if robot is not None:
        robot.body()  # report errors in the file before serving
    for source in recordings:
        try:  # report errors on the terminal
            read_all([source], terminal, Source.read if robot is None else robot.read)
        except MotionlessError as error:
            if len(recordings) == 1:
                raise
            terminal.print(f"{error}: the recording is left out")
        except ColumnError as error:
            if robot is not None:
                raise
            terminal.print(f"{error}: the browser asks what the columns mean")
    from workbench.app.page.server import Server  # dash is slow to import

    server = Server(arguments.port, recordings=recordings, robot=robot)
    terminal.print(f"the workbench is at {server.address} (Ctrl+C ends it)")
    sys.stdout.flush()  # a pipe is buffered
    use_writer(write_choice)
    if not arguments.no_browser:
        Timer(0.3, webbrowser.open, [server.address]).start()
    for name in ("SIGTERM", "SIGHUP"):  # end jobs and delete uploaded files
        number = getattr(signal, name, None)  # Windows has no SIGHUP; nohup ignores it
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    try:
        server.serve()
    except KeyboardInterrupt:
        terminal.print("ended")
    finally:
        with hold_interrupts():  # a second Ctrl+C must not stop the cleanup
            server.close()
