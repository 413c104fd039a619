"""Fixtures that run commands."""

import warnings

import pytest

from workbench.cli import main
from workbench.errors import LONGEST


def split_words(argv):
    return argv[0].split() if len(argv) == 1 and isinstance(argv[0], str) else [str(part) for part in argv]


@pytest.fixture
def run_command(capsys):
    """Run a command, of words or one text, that must succeed: returns what it printed."""

    def run(*argv):
        capsys.readouterr()
        assert main(split_words(argv)) == 0
        return capsys.readouterr().out

    return run


def read_folder(folder):
    """Files of a folder, and what is in them."""
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.fixture
def run_refused(capsys, tmp_path):
    """Run a command that must fail: returns the one line on stderr, once the folder of outputs is as it was."""

    def run(*argv):
        before = read_folder(tmp_path)
        capsys.readouterr()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert main(split_words(argv)) == 2
        out = capsys.readouterr()
        assert out.err.count("\n") == 1 and out.err.startswith("pendulum-ident: ")
        assert "Traceback" not in out.err + out.out and len(out.err) <= LONGEST + len("pendulum-ident: \n")
        assert read_folder(tmp_path) == before
        return out.err

    return run
