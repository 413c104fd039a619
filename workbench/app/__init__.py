"""The workbench in a browser: load, compare, diagnose, add, export, over the same functions as the command line."""

from workbench.app.server import Server, make_app

__all__ = ["Server", "make_app"]
