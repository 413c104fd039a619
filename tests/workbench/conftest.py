"""What tests of the command line share."""

import warnings

import pytest

from workbench.cli import main
from workbench.mistakes import LONGEST


@pytest.fixture
def refused(capsys, tmp_path):
    """Run a command that must fail: returns the one line on stderr, once no new file is in the folder of outputs."""

    def run(*argv):
        before = sorted(tmp_path.rglob("*"))
        capsys.readouterr()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert main([str(part) for part in argv]) == 2
        out = capsys.readouterr()
        assert out.err.count("\n") == 1 and out.err.startswith("pendulum-ident: ")
        assert "Traceback" not in out.err + out.out and len(out.err) <= LONGEST + len("pendulum-ident: \n")
        assert sorted(tmp_path.rglob("*")) == before
        return out.err

    return run
