"""What the console script runs: an interrupt while the libraries load ends as tidily as one later."""

import sys


def main() -> int:
    """Run the command line; returns the exit code."""
    try:
        from workbench.cli import main as run  # takes a while

        return run()
    except KeyboardInterrupt:
        print("pendulum-ident: interrupted", file=sys.stderr)
        return 130
