"""Test of the installed package: `make package` runs it in a new environment and an empty folder."""

import re
import subprocess
import sys
import urllib.request
from pathlib import Path

import gymnasium

PROGRAM = Path(sys.executable).with_name("pendulum-ident")


def main() -> None:
    """Test the command line, the demo, the environment and the app."""
    print(subprocess.check_output([PROGRAM, "--version"], text=True).strip())
    print(subprocess.check_output([PROGRAM, "demo"], text=True).splitlines()[-1])
    assert Path("pendulum-ident-demo/report.html").stat().st_size > 1e6
    env = gymnasium.make("pendulum_env:pendulum_env/DirectDrivePendulum-v0")
    observation, info = env.reset(seed=0)
    assert observation.shape == (3,) and info["position"] == 0
    print("gym.make knows", env.spec.id)
    command = [PROGRAM, "app", "--port", "0", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        address = re.search(r"http://127\.0\.0\.1:\d+/", server.stdout.readline())[0]
        with urllib.request.urlopen(address) as page:
            assert page.status == 200
        server.terminate()
    print("the app answers")


if __name__ == "__main__":
    main()
